"""Assumptions: what model, litmus tests, simulation, simulated boards and prover take for granted, a row each."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Assumption:
    """One thing that a proof takes for granted."""

    name: str
    """As a claim names it."""
    says: str
    by: str
    """The proofs that take it for granted: kinds of citations (cited.py), claims, or parts of the service."""
    wrong: str
    """The consequence where it does not hold."""
    checked: str
    """The experiment that checks it: a path of the tests, or a command."""
    when: str
    """The last check: with each run of the tests, or a date."""


EACH = "each `make test`"
CAMPAIGNS = "each `make campaigns`"

ASSUMPTIONS = (
    Assumption(
        "WRITE", "A write to the port reaches the board in one piece, or cut at its end. Two writes are not mixed, and"
        " bytes go out in the order of the writes.", "model, simulation",
        "Another writer's frame may break up a stop. Each burst begins with bytes that end a cut frame, so the next"
        " repeat stops the wheels.", "tests/board/test_cut_frames.py", EACH,
    ),
    Assumption(
        "MODEL", "The steps of the model are the same as in the code.", "model",
        "The code may have an order of steps that the model has not tried. The simulation runs the code itself.",
        "tests/lab/machine/test_single_faults.py", EACH,
    ),
    Assumption(
        "PAIRS", "The table of model/aarch64/README.md has every pair of accesses whose order matters.",
        "litmus tests",
        "ARM may show an order that no test has tried. The process then sees the new value some ms later, by its bell"
        " or"
        " its next look.",
        "tests/model/test_pairs.py", EACH,
    ),
    Assumption(
        "BARRIER", "CPython releases a lock by a store-release and acquires it by a load-acquire.", "litmus tests",
        "A `Barrier` orders nothing on ARM, so a frame from before a stop may go out after it.",
        "tests/model/test_litmus.py", EACH,
    ),
    Assumption(
        "LIFELINE", "When a process dies, the kernel first marks its robust mutexes and wakes the threads that wait for"
        " them, and only then frees the rest.", "the stop path",
        "Deaths are only reported by the pidfd, 0.4 ms later.", "tests/shm/test_lifeline.py", EACH,
    ),
    Assumption(
        "CRC", "A mixture of two writes of one record never has the right CRC by chance (2^-32 for each torn read).",
        "shared memory", "The service may accept a record that the client never wrote; limits and ramps still hold.",
        "tests/shm/test_cell.py", EACH,
    ),
    Assumption(
        "CLOCK", "CLOCK_MONOTONIC is the same clock for all processes, and nobody sets it.", "deadlines, leases",
        "A deadline comes early or late by the difference.", "tests/e2e/test_suspended.py", EACH,
    ),
    Assumption(
        "RIGHTS", "The service has real-time rights, and no other program of higher priority takes every core.",
        "all times",
        "Stops come later on a busy machine; the service says so at its start, and so do `status` and `doctor`.",
        "tests/e2e/test_starved.py", EACH,
    ),
    Assumption(
        "SYSTEMD", "systemd runs ExecStopPost when the service has died, and its watchdog when the supervisor hangs.",
        "SEVERAL-1, PORT-1", "If the supervisor, the port owner and the stopper die at once, nothing stops the wheels.",
        "tests/systemd/test_service.py", EACH,
    ),
    Assumption(
        "PTY", "A pty behaves as the board's USB port does, except for what tests/vm/README.md lists.",
        "tests, faults, bench",
        "The USB driver may behave in another way; `failstop prove` finds that on the robot itself.",
        "`make vm` (a simulated USB device on a real kernel)", "2026-11-23",
    ),
    Assumption(
        "RECEIVER", "The simulated receiver executes what the board's firmware executes.",
        "tests, faults, simulation, bench",
        "The simulated board may execute a stop that the real one does not; `failstop prove` finds that.",
        "tests/board/test_recorded.py (recordings of firmware that was compiled, or ran in an emulator), `failstop"
        " prove`",
        EACH,
    ),
    Assumption(
        "ENCODER", "A wheel turns as fast as commanded, because its encoder reports its speed to the board.", "LIMIT-1",
        "A motor without its encoder may turn at full speed. If an `arduino` or a `ugv` counts nothing, failstop stops "
        "after a second. Otherwise the IMU may notice it, and the power switch stops it.",
        "`failstop prove` on the robot", "on each robot, by its owner",
    ),
    Assumption(
        "PING", "If a board answers a question that was written after a stop, it has executed the stop.", "PROOF-1",
        "A stop that got lost in between is reported as *acknowledged*.", "tests/board/test_proofs.py", EACH,
    ),
    Assumption(
        "IMU", "Wheels that turn shake the robot more than the noise of its IMU.", "PROOF-1",
        "*Observed* is shown although the wheels turn very slowly.", "tests/procs/telemetry/test_imu.py", EACH,
    ),
    Assumption(
        "SERVO", "A servo ends a timed move by itself and holds it with its torque on.", "ARM-1",
        "The arm goes on moving for the time of its longest move.", "tests/board/test_servos.py", EACH,
    ),
    Assumption(
        "SIMULATED", "The simulated machine's calls behave as those of Linux.", "simulation",
        "A fault that only the real kernel causes is not found there.",
        "tests/lab/machine/test_as_the_kernel.py", EACH,
    ),
    Assumption(
        "WORLDS",
        "The simulated machine lacks durations, caches and drivers, but these cause no order of events that it"
        " does not have.", "simulation", "A scenario may end in another way on a real machine.",
        "tests/lab/machine/test_both_worlds.py", CAMPAIGNS,
    ),
    Assumption(
        "EQUAL", "A run that the simulation leaves out is the same as one that it plays, to the last call and its"
        " time.", "simulation", "A fault at some call may not have been played.",
        "tests/lab/machine/test_equivalents.py", EACH,
    ),
    Assumption(
        "WEAK", "In runs with weak memory, stores are late and loads are early as AArch64 permits.",
        "simulation", "A processor may show an order that no run has; the litmus tests judge each pair by itself.",
        "tests/lab/machine/test_memory.py", EACH,
    ),
    Assumption(
        "USERS", "The kernel keeps users apart: permissions of files, pipes and memory, and the rights of root.",
        "ACCESS-1",
        "Anyone whom the kernel does not keep out may drive within the limits.", "tests/safety/test_table.py", EACH,
    ),
    Assumption(
        "FLOOR", "No program on Linux notices a death sooner than the C program in bench/floor.c.", "bench",
        "The ratios to the floor are better than they should be; the milliseconds are still right.", "`make bench`",
        "2026-11-24",
    ),
    Assumption(
        "BRAKE", "When zero is commanded, the board brakes the wheels with the deceleration in the settings.",
        "DISTANCE-1", "The robot stops later than `failstop config` says.", "`failstop prove` on the robot",
        "on each robot, by its owner",
    ),
)  # fmt: skip
"""Assumptions of every proof, in no order."""

BY_NAME = {row.name: row for row in ASSUMPTIONS}

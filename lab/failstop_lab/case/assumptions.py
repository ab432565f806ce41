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
        "WRITE", "One write to the port reaches the board in one piece or cut at its end; two writes are not mixed,"
        " and bytes"
        " go out in the order of the writes.", "model, simulation",
        "A stop may be broken up by another writer's frame; each burst begins with what ends a cut frame, so the next"
        " repeat stops.", "tests/board/test_cut_frames.py", EACH,
    ),
    Assumption(
        "MODEL", "The steps of the model are the looks and changes of the code.", "model",
        "An interleaving that the model has not seen; the simulation runs the code itself.",
        "tests/lab/machine/test_single_faults.py", EACH,
    ),
    Assumption(
        "PAIRS", "The table of model/aarch64/README.md has every pair of accesses whose order matters.",
        "litmus tests",
        "On ARM an order that no test has; by its bell or its next look the process sees it, some ms later.",
        "tests/model/test_pairs.py", EACH,
    ),
    Assumption(
        "BARRIER", "A lock of CPython is released by a store-release and taken by a load-acquire.", "litmus tests",
        "A `Barrier` orders nothing on ARM: a frame of the epoch before may go out behind a stop.",
        "tests/model/test_litmus.py", EACH,
    ),
    Assumption(
        "LIFELINE", "The kernel marks the robust mutexes of a dead process, and wakes who waits for them, before"
        " anything else"
        " that others can see of it goes.", "the stop path",
        "Deaths are heard by pidfd alone, 0.4 ms later.", "tests/shm/test_lifeline.py", EACH,
    ),
    Assumption(
        "CRC", "A mixture of two writes of one record never has the right CRC by chance (2^-32 for each torn read).",
        "shared memory", "A record of a client may be taken that was never written; limits and ramps still hold.",
        "tests/shm/test_cell.py", EACH,
    ),
    Assumption(
        "CLOCK", "CLOCK_MONOTONIC is one clock for all processes and is never set.", "deadlines, leases",
        "A deadline comes early or late by the difference.", "tests/e2e/test_suspended.py", EACH,
    ),
    Assumption(
        "RIGHTS", "The service has real-time rights, and no other program of higher priority takes every core.",
        "all times", "Stops come later on a busy machine; the start, `status` and `doctor` say so.",
        "tests/e2e/test_starved.py", EACH,
    ),
    Assumption(
        "SYSTEMD", "systemd runs ExecStopPost when the service has died, and its watchdog when the supervisor hangs.",
        "SEVERAL-1, PORT-1", "With supervisor, port owner and stopper dead at once nobody is left to stop.",
        "tests/systemd/test_service.py", EACH,
    ),
    Assumption(
        "PTY", "A pty stands for the board's USB port, but for what tests/vm/README.md lists.", "tests, faults, bench",
        "A driver of USB that behaves in another way; `failstop prove` meets it on the robot itself.",
        "`make vm` (a simulated USB device on a real kernel)", "2026-11-23",
    ),
    Assumption(
        "RECEIVER", "The simulated receiver executes what the board's firmware executes.",
        "tests, faults, simulation, bench",
        "A stop that the simulated board takes and the real one does not; `failstop prove` meets it.",
        "tests/board/test_recorded.py (recorded of firmware that ran in an emulator or was compiled), `failstop"
        " prove`",
        EACH,
    ),
    Assumption(
        "ENCODER", "A wheel turns as fast as its board was told, as far as its encoder tells the board.", "LIMIT-1",
        "A motor without its encoder may turn at full speed; the IMU may see it, the power switch stops it.",
        "`failstop prove` on the robot", "on each robot, by its owner",
    ),
    Assumption(
        "PING", "A board that answers a question which was written behind a stop has executed the stop.", "PROOF-1",
        "A stop that was lost in between is reported as *acknowledged*.", "tests/board/test_proofs.py", EACH,
    ),
    Assumption(
        "IMU", "Wheels that turn shake the robot more than the noise of its IMU.", "PROOF-1",
        "*Observed* is told of wheels that turn very slowly.", "tests/procs/telemetry/test_imu.py", EACH,
    ),
    Assumption(
        "SERVO", "A servo ends a timed move by itself and holds it with its torque on.", "ARM-1",
        "The arm moves on, for the time of its longest move.", "tests/board/test_servos.py", EACH,
    ),
    Assumption(
        "SIMULATED", "The calls of the simulated machine behave as those of Linux.", "simulation",
        "A fault that only the kernel's own behaviour brings about is not met there.",
        "tests/lab/machine/test_as_the_kernel.py", EACH,
    ),
    Assumption(
        "WORLDS", "What the simulated machine does not have (durations, caches, drivers) changes no order of events"
        " that it"
        " has.", "simulation", "A scenario that ends in another way on a real machine.",
        "tests/lab/machine/test_both_worlds.py", CAMPAIGNS,
    ),
    Assumption(
        "EQUAL", "A run that the simulation leaves out is the same as one that it plays, to the last call and its"
        " time.", "simulation", "A fault at a call that no run has played.",
        "tests/lab/machine/test_equivalents.py", EACH,
    ),
    Assumption(
        "WEAK", "Where shared memory is drawn as weak, stores are late and loads early as AArch64 permits it.",
        "simulation", "An order that a processor shows and no run has; the litmus tests judge each pair by itself.",
        "tests/lab/machine/test_memory.py", EACH,
    ),
    Assumption(
        "USERS", "The kernel keeps users apart: permissions of files, pipes and memory, and the rights of root.",
        "ACCESS-1",
        "Whoever is not kept out by the kernel may drive within the limits.", "tests/safety/test_table.py", EACH,
    ),
    Assumption(
        "FLOOR", "Nothing that waits for a death on Linux is sooner than the C program of bench/floor.c.", "bench",
        "The ratios to the floor are better than they should be; the milliseconds stand.", "`make bench`", "2026-11-24",
    ),
    Assumption(
        "BRAKE", "A board that is told zero brakes the wheels with the deceleration that the settings name.",
        "DISTANCE-1", "The robot stops later than `failstop config` says.", "`failstop prove` on the robot",
        "on each robot, by its owner",
    ),
)  # fmt: skip
"""Assumptions of every proof, in no order."""

BY_NAME = {row.name: row for row in ASSUMPTIONS}

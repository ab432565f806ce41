"""Claims: what failstop says of itself, each with a name, a bound and what would show that it is wrong.

A test cites a claim by the mark `claim`, a class of faults, a property of the model, a litmus test, a rule of the
simulation and a row of the bench by a table beside them (cited.py gathers all). CI fails for a claim that nothing
cites, for a name that no claim has, and for a claim whose bound is not that of the rows which cite it.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Claim:
    """One sentence that a user may rely on."""

    name: str
    """As it is cited, for example `DEATH-1`."""
    says: str
    bound_ms: float | None
    """The longest time to the first stop frame at the first board (p99 of a campaign), in ms; None: it has no time."""
    counted: str
    """The moment that the time counts from, or the events that a claim without a time counts."""
    assumes: tuple[str, ...]
    """Names of assumptions (assumptions.py)."""
    falsified: str
    """An observation that would show it to be wrong."""


CLAIMS = (
    Claim(
        "START-1",
        "The first bytes that a run of the service sends to the board are a stop.",
        150.0, "from the start of `failstop run`", ("PTY", "RECEIVER"),
        "a byte at the board before the burst of a run",
    ),
    Claim(
        "DEATH-1",
        "If any one process of the service dies, at whatever moment, the wheels stop.",
        20.0, "from the death", ("LIFELINE", "WRITE", "RECEIVER", "RIGHTS"),
        "a kill after which the board executes no stop frame in its time",
    ),
    Claim(
        "HANG-1",
        "If a process of the service hangs or spins, the wheels stop.",
        515.0, "from the hang; 75 ms if the gate or the supervisor hangs, 115 the port owner, 265 the stopper",
        ("CLOCK", "RIGHTS", "SYSTEMD"),
        "a process that is halted for longer than its deadline, and wheels that keep turning",
    ),
    Claim(
        "SEVERAL-1",
        "If two to five processes die or hang at once, the wheels stop. If none is left that can write, the stop "
        "tool that systemd starts writes the stop.",
        265.0, "from the first of the faults", ("LIFELINE", "WRITE", "SYSTEMD", "RIGHTS"),
        "any set of deaths and hangs after which no stop frame is executed",
    ),
    Claim(
        "ASK-1",
        "Every local user may stop the robot, with any bytes in the stop pipe, and anyone at the board with its "
        "button or key. A service that a user starts by hand obeys only that user.",
        10.0, "from the request", ("RIGHTS",),
        "a request that stops nothing, or a user whose request is refused",
    ),
    Claim(
        "ASK-2",
        "A stop request is answered even if the machine has no processor time, memory, descriptor or disk to spare.",
        1020.0, "from the request or the fault; 20 ms unless names of shared memory are removed", ("RIGHTS",),
        "a shortage under which a request stops nothing",
    ),
    Claim(
        "CLIENT-1",
        "A driver that dies disables motion. A driver that falls silent stops the wheels when its command has timed "
        "out. A command that is not a number, or a second program that commands as one source, latches a stop.",
        320.0, "from its last command; 20 from its death or an exception", ("LIFELINE", "CLOCK"),
        "a driver that has died or fallen silent, and wheels that still obey its last command",
    ),
    Claim(
        "MEMORY-1",
        "A client that damages the memory that it shares with the service can't move anything by that, and only "
        "that client loses its connection.",
        60.0, "from its last command", ("CRC",),
        "damage that turns a wheel, prevents a stop or ends the service",
    ),
    Claim(
        "SENSOR-1",
        "An obstacle sensor or an interlock that falls silent stops the motion that programs command.",
        525.0, "from the last delivery or assertion", ("CLOCK",),
        "a program that drives on without a valid scan or interlock",
    ),
    Claim(
        "ATTEND-1",
        "If an operator is required (`attend.required`), an operator who leaves or is no longer heard latches a "
        "stop.",
        1020.0, "from the last proof, with a lease of 1 s (`attend.lease_s`)", ("CLOCK",),
        "a robot that drives on without its operator",
    ),
    Claim(
        "PORT-1",
        "When an unplugged board is back, it is told to stop before anything else is written to it.",
        1200.0, "from its return; 20 ms unless the supervisor hangs meanwhile", ("PTY", "SYSTEMD"),
        "a board that is back, and turns its wheels without an enable",
    ),
    Claim(
        "BOARD-1",
        "If a board takes no bytes, hears nothing or does not obey, failstop reports that and writes the stop again "
        "and again.",
        250.0, "from when it takes or hears bytes again", ("PING", "IMU"),
        "a board that hears again and is not stopped, or a stop that is shown as obeyed although it is not",
    ),
    Claim(
        "RUNAWAY-1",
        "If the board reports what its wheels do, a wheel that turns faster than commanded, in the other direction, "
        "or although zero is commanded, stops the robot.",
        1700.0, "from when it runs away, at 0.1 m/s, on the board that reports least often", ("RECEIVER", "WRITE"),
        "a wheel that is reported beyond its margin for its run-down time without slowing down, and is not stopped",
    ),
    Claim(
        "SILENCE-1",
        "When a board that reported all the time falls silent, failstop says so, and stops the wheels while motion is"
        " enabled.",
        1000.0, "from its last report, if its reports come at least every 0.1 s", ("RECEIVER", "WRITE"),
        "a board that says nothing for longer, while motion is enabled",
    ),
    Claim(
        "TIME-1",
        "If the machine froze or slept, the wheels are stopped as soon as it is back. Steps of the wall clock stop "
        "nothing.",
        65.0, "from the thaw or waking", ("CLOCK",),
        "motion that goes on after a sleep",
    ),
    Claim(
        "END-1",
        "When the service is ended normally, it leaves the wheels stopped.",
        20.0, "from SIGTERM", ("WRITE",),
        "an end after which the last speed that the board has got is not zero",
    ),
    Claim(
        "ARM-1",
        "A stop of the wheels also stops the arm, with its torque on.",
        575.0, "from the fault until the last joint is at rest; 65 ms for deaths", ("SERVO",),
        "a joint that turns later than its row, or lets go",
    ),
    Claim(
        "MOVE-1",
        "Only one process writes motion, and it checks for a stop (the epoch) just before each frame. So after a "
        "stop by another process at most one motion frame follows, which had already passed that check; after a stop "
        "by the same process none.",
        None, "motion frames after a stop: 0, or that one", ("MODEL", "WRITE", "PAIRS", "BARRIER"),
        "a second frame of motion after a stop",
    ),
    Claim(
        "MOVE-2",
        "After a latched stop nothing moves until somebody resets and enables. After a start, a disable, a lost "
        "interlock or a driver's death nothing moves until somebody enables. No process of failstop does either by "
        "itself.",
        None, "motion frames before the enable: 0", ("MODEL", "PAIRS", "SIMULATED"),
        "a motion frame without an enable that a client asked for after the stop",
    ),
    Claim(
        "GUARD-1",
        "A driver at the guard port moves nothing that the board itself would not move for it, nothing beyond the "
        "limits, and nothing after its death.",
        None, "motion frames while disabled or latched, of a dead driver, or beyond a limit: 0", ("PTY", "USERS"),
        "a wheel that turns because of bytes that the board would refuse, or of a driver that has died",
    ),
    Claim(
        "LIMIT-1",
        "Nothing drives faster, or changes speed faster, than the settings allow, whichever program commands.",
        None, "frames past a limit or a ramp: 0", ("ENCODER",),
        "a frame whose wheel speeds are more than a limit",
    ),
    Claim(
        "CAUSE-1",
        "The first cause of a stop is kept until the reset, and shown in words, with what to do next.",
        None, "stops with another cause than the first: 0", ("PAIRS",),
        "a latched stop that names a later cause, or none",
    ),
    Claim(
        "PROOF-1",
        "The three proofs of a stop are shown separately: written, acknowledged, observed. No proof is shown that "
        "was not seen.",
        None, "proofs shown and not seen: 0", ("PING", "IMU"),
        "a screen that shows a proof which the board has not given",
    ),
    Claim(
        "ACCESS-1",
        "Only members of the group `failstop` may drive, reset and enable. Everybody else is refused, and so are "
        "their memory and folders.",
        None, "ways in for others: 0", ("USERS",),
        "a user outside of the group who moves a wheel, or takes a stop away",
    ),
    Claim(
        "BOARD-2",
        "Each board's stop works from every state of its receiver, also after cut frames and next to another "
        "writer.",
        None, "stops lost: 0; 40 ms later than at the first board by its own line and loop", ("RECEIVER", "WRITE"),
        "a state of the board's own firmware from which a burst does not stop the wheels",
    ),
    Claim(
        "WATCHDOG-1",
        "If a board has its own watchdog, failstop arms it, feeds it only while the service lives, and tests show that "
        "the board stops the wheels when it hears nothing.",
        None, "boards that stop by themselves within the time that was set", ("RECEIVER",),
        "a board whose `status` says armed, and that drives on when everything is frozen",
    ),
    Claim(
        "DISTANCE-1",
        "Wherever a limit is set, failstop says how far the robot goes until it has stopped, from the deceleration "
        "that you measured.",
        None, "5 % of the way of simulated wheels", ("BRAKE",),
        "two screens that show different distances, or wheels that brake as the settings say and roll further",
    ),
    Claim(
        "RETURN-1",
        "When nothing fails any more, a reset and an enable are granted, and the wheels turn.",
        None, "2 s of simulated time; every run of the model ends", ("SIMULATED", "MODEL"),
        "a service that is whole and never grants motion again",
    ),
)  # fmt: skip
"""Every claim, in the order of docs/safety.md."""

BY_NAME = {claim.name: claim for claim in CLAIMS}

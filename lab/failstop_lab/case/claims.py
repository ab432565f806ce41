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
        "The first bytes that a run of the service sends to the board are a stop. If the service can't "
        "read its settings, it sends the stop of the board of the last run, or, without a last run, the stop of `rrc`.",
        150.0, "from the start of `failstop run`", ("PTY", "RECEIVER"),
        "a byte at the board before the burst of a run",
    ),
    Claim(
        "DEATH-1",
        "If any one of the service's processes dies, at any moment, the wheels stop.",
        20.0, "from the death", ("LIFELINE", "WRITE", "RECEIVER", "RIGHTS"),
        "a kill after which the board executes no stop frame in its time",
    ),
    Claim(
        "HANG-1",
        "If one of the service's processes hangs or runs in an endless loop, the wheels stop.",
        515.0,
        "from the hang. 515 ms is for telemetry; the stopper has 265 ms, the port owner 115 ms, the gate and the "
        "supervisor have 75 ms",
        ("CLOCK", "RIGHTS", "SYSTEMD"),
        "a process that is halted for longer than its deadline, and wheels that keep turning",
    ),
    Claim(
        "SEVERAL-1",
        "If two to five of the service's processes die or hang at once, the wheels stop. If no process is left that "
        "can write the stop, systemd starts the stop tool, which writes it.",
        265.0,
        "from the first of the faults. This bar does not apply if the supervisor hangs and neither the port owner nor "
        "the stopper can write: then [systemd's watchdog](#what-is-not-claimed) has to notice that, after 1 s",
        ("LIFELINE", "WRITE", "SYSTEMD", "RIGHTS"),
        "any set of deaths and hangs after which no stop frame is executed",
    ),
    Claim(
        "ASK-1",
        "Every local user can stop the robot by writing anything into the stop pipe, and anyone can stop it with the "
        "board's stop key or with any gamepad button except MODE. If a user without write access to `/run` starts a "
        "service by hand, that service takes stop requests only from this user.",
        10.0, "from the request", ("RIGHTS",),
        "a request that stops nothing, or a user whose request is refused",
    ),
    Claim(
        "ASK-2",
        "A stop request stops the wheels even if programs of a lower priority than failstop's keep every processor "
        "core busy, or if the machine has no memory, file descriptor or disk space to spare. If somebody deletes the "
        "service's shared memory or its stop pipe, the service stops the wheels and ends.",
        1020.0, "from the deletion; 20 ms from a stop request, also during a shortage", ("RIGHTS",),
        "a shortage under which a request stops nothing",
    ),
    Claim(
        "CLIENT-1",
        "When a driver dies, motion is disabled, unless `gate.driver_death` is `stay`. When a driver falls "
        "silent, the wheels stop after its last command has timed out. A command that is not a number latches a stop, "
        "and so does a second program that commands as the same source.",
        320.0, "from the last command of a driver that falls silent; 20 ms from everything else", ("LIFELINE", "CLOCK"),
        "a driver that has died or fallen silent, and wheels that still obey its last command",
    ),
    Claim(
        "MEMORY-1",
        "If a client damages the memory that it shares with the service, no wheel turns because of that, and only that "
        "client loses its connection. If that client was driving, the wheels stop and motion is disabled.",
        60.0, "from the client's last command until the stop, if the client was driving", ("CRC",),
        "damage that turns a wheel, prevents a stop or ends the service",
    ),
    Claim(
        "SENSOR-1",
        "If the obstacle sensor falls silent, motion that a program commands is stopped. If an interlock is no longer "
        "asserted, motion is disabled.",
        525.0, "from the sensor's last reading, or the interlock's last assertion", ("CLOCK",),
        "a program that drives on without a valid scan or interlock",
    ),
    Claim(
        "ATTEND-1",
        "If an operator must be present (`attend.required`), a stop is latched when the last operator leaves or is no "
        "longer heard.",
        1020.0, "from the last sign of the operator, with a lease of 1 s (`attend.lease_s`)", ("CLOCK",),
        "a robot that drives on without its operator",
    ),
    Claim(
        "PORT-1",
        "When a board that was unplugged is back, failstop writes a stop to it before anything else.",
        1200.0, "from the board's return, if the supervisor hangs just then; otherwise it is 20 ms", ("PTY", "SYSTEMD"),
        "a board that is back, and turns its wheels without an enable",
    ),
    Claim(
        "BOARD-1",
        "If a board accepts no bytes, hears nothing or does not obey, failstop reports it and keeps repeating the "
        "stop.",
        250.0, "from the moment when the board accepts or hears bytes again", ("PING", "IMU"),
        "a board that hears again and is not stopped, or a stop that is shown as obeyed although it is not",
    ),
    Claim(
        "RUNAWAY-1",
        "failstop stops the robot when a wheel runs away: the wheel does not slow down, and it either turns faster "
        "than commanded, turns the other way, or has not come to rest since it was commanded zero. This holds while "
        "motion is enabled, with boards that report their wheels more often than once a second.",
        1850.0, "from when the wheel runs away, at 0.1 m/s, with the board that is compared least often (`ugv`)",
        ("RECEIVER", "WRITE"),
        "a wheel that is reported beyond its margin for its run-down time without slowing down, and is not stopped",
    ),
    Claim(
        "SILENCE-1",
        "When a board that has reported regularly falls silent, failstop shows it, and stops the wheels if motion is "
        "enabled.",
        1000.0, "from the board's last report, if it reports at least every 0.1 s", ("RECEIVER", "WRITE"),
        "a board that says nothing for longer, while motion is enabled",
    ),
    Claim(
        "TIME-1",
        "If the computer was frozen or asleep, failstop stops the wheels as soon as the computer runs again. Setting "
        "the system clock does not stop the robot.",
        65.0, "from the moment when the computer runs again", ("CLOCK",),
        "motion that goes on after a sleep",
    ),
    Claim(
        "END-1",
        "When the service ends normally, the wheels are stopped.",
        20.0, "from SIGTERM", ("WRITE",),
        "an end after which the last speed that the board has got is not zero",
    ),
    Claim(
        "ARM-1",
        "A stop of the wheels also stops the joints of an arm that the settings name, and these joints keep their "
        "torque.",
        575.0, "from the hang of telemetry until the last joint is at rest. If a process dies, it is 65 ms", ("SERVO",),
        "a joint that turns later than its row, or lets go",
    ),
    Claim(
        "MOVE-1",
        "Only the port owner writes motion, and just before each motion frame it checks the epoch, which every stop "
        "raises. So if another process writes a stop, at most one motion frame can follow it: the frame that had "
        "already passed the check. If the port owner writes the stop, no motion frame follows.",
        None, "motion frames after a stop: 0, or that one frame", ("MODEL", "WRITE", "PAIRS", "BARRIER"),
        "a second frame of motion after a stop",
    ),
    Claim(
        "MOVE-2",
        "After a latched stop, nothing moves until somebody resets the stop and enables motion, except for the one "
        "frame of MOVE-1. After a start of the service (which also ends a latched stop), a disable, a lost "
        "interlock, or the death of a driver (unless `gate.driver_death` is `stay`), nothing moves until somebody "
        "enables motion. failstop never enables by itself, and while it runs it resets no stop by itself.",
        None, "motion frames before the enable: 0, or the one frame of MOVE-1", ("MODEL", "PAIRS", "SIMULATED"),
        "a motion frame without an enable that a client asked for after the stop",
    ),
    Claim(
        "GUARD-1",
        "A driver at the guard port can't turn a wheel with bytes that the board itself would refuse, can't exceed the "
        "limits, and can't turn a wheel after it has died.",
        None,
        "motion frames while motion is disabled or a stop is latched, from a dead driver, or above a limit: 0, or the "
        "one frame of MOVE-1",
        ("PTY", "USERS"),
        "a wheel that turns because of bytes that the board would refuse, or of a driver that has died",
    ),
    Claim(
        "LIMIT-1",
        "No program can make the robot drive faster, or change its speed faster, than the settings allow.",
        None, "motion frames that exceed a limit or a ramp: 0", ("ENCODER",),
        "a frame whose wheel speeds are more than a limit",
    ),
    Claim(
        "CAUSE-1",
        "failstop keeps the first cause of a stop until the reset, and shows it in words, with what to do next.",
        None, "stops that show another cause than the first: 0", ("PAIRS",),
        "a latched stop that names a later cause, or none",
    ),
    Claim(
        "PROOF-1",
        "failstop shows the three proofs of a stop (written, acknowledged, observed) separately, and never shows a "
        "proof that it has not received.",
        None, "proofs that are shown but were not received: 0", ("PING", "IMU"),
        "a screen that shows a proof which the board has not given",
    ),
    Claim(
        "ACCESS-1",
        "Only members of the group `failstop`, the service's own user and root can drive, reset and enable. failstop "
        "refuses all other users, and any memory or folder that belongs to them.",
        None, "attempts of other users that succeed: 0", ("USERS",),
        "a user outside of the group who moves a wheel, or takes a stop away",
    ),
    Claim(
        "BOARD-2",
        "Each board's stop works whatever state the board's receiver is in, also after a frame that was cut off, and "
        "while another process writes.",
        None,
        "stops lost: 0. A stop takes at most 40 ms longer than with Hiwonder's board, 150 ms through some USB adapters",
        ("RECEIVER", "WRITE"),
        "a state of the board's own firmware from which a burst does not stop the wheels",
    ),
    Claim(
        "WATCHDOG-1",
        "If a board has its own watchdog, failstop arms it, and feeds it only while the service lives. If the board "
        "hears nothing for the time that was set for the watchdog, because the service no longer lives or the cable is "
        "out, it stops its wheels or lets them roll out, as tests show.",
        None, "boards that still drive after the time that was set for the watchdog: 0", ("RECEIVER",),
        "a board whose `status` says armed, and that drives on when everything is frozen",
    ),
    Claim(
        "DISTANCE-1",
        "Wherever you set a speed limit, failstop shows how far the robot goes until it has stopped. It computes this "
        "distance from the deceleration that you measured.",
        None, "simulated wheels roll at most 5 % further than shown", ("BRAKE",),
        "two screens that show different distances, or wheels that brake as the settings say and roll further",
    ),
    Claim(
        "RETURN-1",
        "When nothing fails any more, failstop grants a reset and an enable, and the wheels turn again.",
        None, "simulated time until the wheels turn again: at most 2 s. Runs of the "
        "[model](how-it-is-tested.md#the-stop-protocol-in-a-model-checker) of the stop protocol in which the wheels "
        "never turn again: 0",
        ("SIMULATED", "MODEL"),
        "a service that is whole and never grants motion again",
    ),
)  # fmt: skip
"""Every claim, in the order of docs/safety.md."""

BY_NAME = {claim.name: claim for claim in CLAIMS}

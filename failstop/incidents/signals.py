"""Signals: what is computed from an incident's series - vibration, verdicts on the wheels, silences. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from failstop.board import framing, servos
from failstop.board.interface import BOARD
from failstop.incidents.incident import Incident, Write
from failstop.incidents.motors import Motors
from failstop.policy.processes import BY_NAME
from failstop.procs.telemetry.still import HOLD_NS, LEAST_SAMPLES, WINDOW_NS, StillJudge
from failstop.shm import box, layout

Array = npt.NDArray[np.float64]

FIRST_NS = WINDOW_NS + HOLD_NS
"""Nothing can be still sooner."""


def vibration(incident: Incident) -> tuple[Array, Array]:
    """(ms from the cause, rad/s): the larger of the standard deviations of gyro x and y over the window of 0.5 s that
    ends there, as telemetry judges it; no value where the window holds too few samples."""
    samples = incident.imu
    times = np.array([sample.ns - incident.cause_ns for sample in samples], dtype=np.int64)
    if not len(times):
        return np.empty(0), np.empty(0)
    first = np.searchsorted(times, times - WINDOW_NS, side="right")
    counts = np.arange(1, len(times) + 1) - first
    worst = np.zeros(len(times))
    for axis in (0, 1):
        values = np.array([sample.rate_radps[axis] for sample in samples])
        sums = np.concatenate(([0.0], np.cumsum(values)))
        squares = np.concatenate(([0.0], np.cumsum(values**2)))
        mean = (sums[1:] - sums[first]) / counts
        variance = (squares[1:] - squares[first]) / counts - mean**2
        worst = np.maximum(worst, np.sqrt(np.maximum(variance, 0.0)))
    full = (counts >= LEAST_SAMPLES) & (times - times[0] >= WINDOW_NS)
    return times[full] / 1e6, worst[full]


BREAK_MS = 100.0
"""A board that sends 110 samples a second and none for so long was silent: no line is drawn across."""


def broken(at_ms: Array, values: Array) -> tuple[Array, Array]:
    """A curve with no value (NaN) wherever its samples are further apart than BREAK_MS."""
    gaps = np.nonzero(np.diff(at_ms) > BREAK_MS)[0] + 1
    return np.insert(at_ms, gaps, at_ms[gaps - 1]), np.insert(values, gaps, np.nan)


def verdicts(incident: Incident) -> list[tuple[int, bool]]:
    """(when it was found, still or not) at each change of telemetry's judgement on the wheels, judged again."""
    judge = StillJudge(float(incident.settings.get("still.std_radps", "0.0035")))
    found: list[tuple[int, bool]] = []
    for sample in incident.imu:
        judge.take(sample.rate_radps[0], sample.rate_radps[1], sample.ns)
        still = judge.still_ns > 0
        if not judge.judged_ns or sample.ns - incident.imu[0].ns < FIRST_NS:
            continue
        if not found or found[-1][1] != still:
            found.append((sample.ns, still))
    return found


@dataclass(frozen=True)
class Silence:
    """A process that did not beat for longer than it should."""

    process: str
    since_ns: int
    """Its last beat before."""
    until_ns: int
    """When it was last seen to be silent."""
    ended: bool
    """It beat again, within what is saved."""


def allowed_ns(incident: Incident, process: str) -> int:
    """How long a process may be silent without anybody minding."""
    if process in (layout.GATE, layout.SUPERVISOR):
        return round(float(incident.settings.get("gate.lease_s", "0.06")) * 1e9)
    return BY_NAME[process].deadline_ns


def silences(incident: Incident) -> list[Silence]:
    """Every silence that the supervisor saw, the oldest first; of its own, those that it noticed afterwards."""
    found = []
    for index, process in enumerate(layout.PROCESSES):
        allowed = allowed_ns(incident, process)
        since_ns = until_ns = 0
        for ns, times in incident.beats:
            silent_us, before_us = times[index]
            if silent_us * 1000 > allowed:
                seen_ns = ns - before_us * 1000
                since_ns = since_ns or seen_ns - silent_us * 1000
                until_ns = seen_ns
            elif since_ns:
                found.append(Silence(process, since_ns, until_ns, True))
                since_ns = 0
        if since_ns:
            found.append(Silence(process, since_ns, until_ns, False))
    return sorted(found, key=lambda silence: silence.since_ns)


MOVES_AT = 8
"""Where the first servo of a move stands in its frame."""
MOTION = "motion"
ZERO = "zero"
PING = "ping"
ARM = "arm"
"""A frame for the arm's servos."""
OTHER = "other"
STOP_BURST = "stop burst"
REST = "rest"


def kind(write: Write) -> str:
    """What was written: MOTION, ZERO (a motor frame of zeros), PING, ARM, OTHER, STOP_BURST, or the REST of one."""
    if write.kind == box.BURST:
        return STOP_BURST
    if write.kind == box.REST:
        return REST
    if write.head.startswith(framing.MOTOR_HEAD):
        return MOTION if any(speeds_rps(write)) else ZERO
    if write.head[2:3] == bytes((framing.BUS_SERVO,)):
        return ARM
    return PING if write.head in BOARD.pings else OTHER


def joint_names(incident: Incident) -> dict[int, str]:
    """The arm's joints by their servos; none without an arm."""
    found = {}
    for key, value in incident.settings.items():
        family, _, rest = key.partition(".")
        name, _, last = rest.partition(".")
        if family == "joints" and last == "servo":
            found[int(value)] = name
    return found


def joint_tracks(incident: Incident) -> dict[int, list[tuple[int, int]]]:
    """Where each servo was sent: (when, pulses), the oldest first."""
    found: dict[int, list[tuple[int, int]]] = {}
    for write in incident.writes:
        head = write.head
        if write.taken and len(head) > MOVES_AT and head[2] == framing.BUS_SERVO and head[4] == servos.MOVE:
            for at in range(MOVES_AT, min(MOVES_AT + 3 * head[7], len(head) - 3), 3):
                found.setdefault(head[at], []).append((write.ns, head[at + 1] | head[at + 2] << 8))
    return found


def joint_readings(incident: Incident) -> dict[int, list[tuple[int, int]]]:
    """Where each servo said that it was: (when, pulses). A 0, which a late answer makes of the next, is no place."""
    found: dict[int, list[tuple[int, int]]] = {}
    for ns, servo, what, value in incident.servo_answers:
        if what == servos.POSITION and value:
            found.setdefault(servo, []).append((ns, value))
    return found


def joint_goals(incident: Incident) -> dict[int, list[tuple[int, float]]]:
    """Where each servo was to be: (when, pulses), of trajectories (their ends) and follow; a rate is no place."""
    found: dict[int, list[tuple[int, float]]] = {}
    for goal in incident.arm_goals:
        for servo, aim in goal.aims.items() if goal.mode in ("trajectory", "follow") else ():
            found.setdefault(servo, []).append((goal.ns, aim))
    return found


WHEELS = ("front left", "rear left", "front right", "rear right")


def wheel_ids(incident: Incident) -> tuple[int, ...]:
    """The wire id of each of WHEELS."""
    return tuple(int(incident.settings.get(f"wheels.id_{number}", number - 1)) for number in (1, 2, 3, 4))


def speeds_rps(write: Write) -> tuple[float, float, float, float]:
    """The wheel speeds of a motor frame, by wire id, as the board's firmware reads them."""
    return Motors().execute(write.head[4:-1])

"""Signals: what is computed from an incident's series, for words, picture and export alike - vibration, verdicts on the
wheels, silences, what the gate said, where the arm went. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from failstop.board import framing, servos
from failstop.incidents.incident import Incident
from failstop.policy.processes import BY_NAME
from failstop.procs.telemetry.still import HOLD_NS, LEAST_SAMPLES, WINDOW_NS, StillJudge
from failstop.shm import layout

Array = npt.NDArray[np.float64]
Points = list[tuple[int, float]]
"""When (CLOCK_MONOTONIC ns), and a value."""

FIRST_NS = WINDOW_NS + HOLD_NS
"""Nothing can be still sooner."""
BREAK_MS = 100.0
"""A board that sends 110 samples a second and none for so long was silent: no line is drawn across."""
WHEELS = ("front left", "rear left", "front right", "rear right")
MOVES_AT = 8
"""Where the first servo of a move stands in its frame."""
DRIVING = "driving"
SILENT = "silent"


def columns(incident: Incident, points: Sequence[tuple[int, float]]) -> tuple[Array, Array]:
    """(ms from the cause, values)."""
    found = np.array([(incident.ms(ns), value) for ns, value in points], dtype=float).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def broken(at_ms: Array, values: Array) -> tuple[Array, Array]:
    """A curve with no value (NaN) wherever its samples are further apart than BREAK_MS."""
    gaps = np.nonzero(np.diff(at_ms) > BREAK_MS)[0] + 1
    return np.insert(at_ms, gaps, at_ms[gaps - 1]), np.insert(values, gaps, np.nan)


def still_radps(incident: Incident) -> float:
    """Wheels that shake the gyro less are still."""
    return incident.number("still.std_radps", 0.0035)


def vibration(incident: Incident) -> tuple[Array, Array]:
    """(ms from the cause, rad/s): the larger of the standard deviations of gyro x and y over the window of 0.5 s that
    ends there, as telemetry judges it; no value where the window holds too few samples."""
    times = np.array([sample.ns - incident.cause_ns for sample in incident.imu], dtype=np.int64)
    rates = np.array([sample.rate_radps[:2] for sample in incident.imu], dtype=float).reshape(-1, 2)
    firsts = np.searchsorted(times, times - WINDOW_NS, side="right")
    windows = [(at, first) for at, first in enumerate(firsts) if at - first >= LEAST_SAMPLES - 1]
    full = [(at, first) for at, first in windows if times[at] - times[0] >= WINDOW_NS]
    spread = np.array([rates[first : at + 1].std(axis=0).max() for at, first in full])
    return times[[at for at, _ in full]] / 1e6, spread


def verdicts(incident: Incident) -> list[tuple[int, bool]]:
    """(when it was found, still or not) at each change of telemetry's judgement on the wheels, judged again."""
    judge = StillJudge(still_radps(incident))
    found: list[tuple[int, bool]] = []
    for sample in incident.imu:
        judge.take(sample.rate_radps[0], sample.rate_radps[1], sample.ns)
        still = judge.still_ns > 0
        if not judge.judged_ns or sample.ns - incident.imu[0].ns < FIRST_NS:
            continue
        if not found or found[-1][1] != still:
            found.append((sample.ns, still))
    return found


class Silence(NamedTuple):
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
        return round(incident.number("gate.lease_s", 0.06) * 1e9)
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
                until_ns = ns - before_us * 1000
                since_ns = since_ns or until_ns - silent_us * 1000
            elif since_ns:
                found.append(Silence(process, since_ns, until_ns, True))
                since_ns = 0
        if since_ns:
            found.append(Silence(process, since_ns, until_ns, False))
    return sorted(found, key=lambda silence: silence.since_ns)


def deaths(incident: Incident, process: str) -> list[int]:
    """When it was told that a process had died."""
    return [event.ns for event in incident.events if event.kind == "died" and event.fields.get("process") == process]


def gate_spans(incident: Incident) -> list[tuple[str, int, int]]:
    """(What the gate said, from when, until when), without gaps; where it missed its ticks or was dead, SILENT."""
    if not incident.ticks:
        return []
    allowed, died = allowed_ns(incident, layout.GATE), deaths(incident, layout.GATE)
    parts: list[tuple[str, int, int]] = []
    for tick, after in pairwise(incident.ticks):
        silent = after.ns - tick.ns > allowed or any(tick.ns < ns < after.ns for ns in died)
        parts.append((SILENT if silent else tick.block, tick.ns, after.ns))
    last_ns, end_ns = incident.ticks[-1].ns, incident.span_ns()[1]
    if end_ns - last_ns > allowed:
        parts.append((SILENT, last_ns, end_ns))
    runs = [(what, list(run)) for what, run in groupby(parts, itemgetter(0))]
    return [(what, run[0][1], run[-1][2]) for what, run in runs]


@dataclass(frozen=True)
class Joint:
    """One servo of the arm over time, in pulses."""

    servo: int
    name: str
    """Of the settings; empty: they name none."""
    sent: Points = field(default_factory=list)
    """Where it was sent."""
    read: Points = field(default_factory=list)
    """Where it said that it was. A 0, which a late answer makes of the next, is no place."""
    goals: Points = field(default_factory=list)
    """Where it was to be, of trajectories (their ends) and follow; a rate is no place."""


def joint_names(incident: Incident) -> dict[int, str]:
    """The arm's joints by their servos; none without an arm."""
    parts = ((key.split("."), value) for key, value in incident.settings.items())
    return {int(value): key[1] for key, value in parts if key[0] == "joints" and key[2:] == ["servo"]}


def joints(incident: Incident) -> list[Joint]:
    """Each servo that was sent somewhere, read or named, by its number."""
    found = {servo: Joint(servo, name) for servo, name in joint_names(incident).items()}

    def of(servo: int) -> Joint:
        return found.setdefault(servo, Joint(servo, ""))

    for write in incident.writes:
        head = write.head
        if write.taken and len(head) > MOVES_AT and head[2] == framing.BUS_SERVO and head[4] == servos.MOVE:
            for at in range(MOVES_AT, min(MOVES_AT + 3 * head[7], len(head) - 3), 3):
                of(head[at]).sent.append((write.ns, head[at + 1] | head[at + 2] << 8))
    for ns, servo, what, value in incident.servo_answers:
        if what == servos.POSITION and value:
            of(servo).read.append((ns, value))
    for goal in incident.arm_goals:
        for servo, aim in goal.aims.items() if goal.mode in ("trajectory", "follow") else ():
            of(servo).goals.append((goal.ns, aim))
    return [found[servo] for servo in sorted(found)]


def wheel_ids(incident: Incident) -> tuple[int, ...]:
    """The wire id of each of WHEELS."""
    return tuple(int(incident.number(f"wheels.id_{number}", number - 1)) for number in (1, 2, 3, 4))

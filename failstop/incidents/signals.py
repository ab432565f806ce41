"""Signals: what is computed from an incident's series, for words, picture and export alike - verdicts on the wheels,
silences, what the gate said, where the arm went. Pure."""

from __future__ import annotations

from itertools import groupby, pairwise
from operator import itemgetter
from typing import Any, NamedTuple

from failstop.board import framing, servos
from failstop.incidents.incident import Incident
from failstop.policy.processes import BY_NAME
from failstop.procs.telemetry.still import HOLD_NS, WINDOW_NS, StillJudge
from failstop.shm import blocks, layout

Points = list[tuple[int, float]]
"""When (CLOCK_MONOTONIC ns), and a value."""
FIRST_NS = WINDOW_NS + HOLD_NS
"""Nothing can be still sooner."""
LEAST_MS = 1.0
WHEELS = ("front left", "rear left", "front right", "rear right")
MOVES_AT = 8
"""Where the first servo of a move stands in its frame."""
DRIVING = "driving"
SILENT = "silent"
SAYS = {
    DRIVING: "the wheels may turn",
    "estop": "a stop is latched",
    blocks.DISABLED: "motion is disabled",
    blocks.NO_COMMAND: "no command",
    blocks.NO_SCAN: "no obstacle sensor",
    SILENT: "the gate is silent",
}
"""What the gate says, or that it says nothing, for people."""


def verdicts(incident: Incident) -> list[tuple[int, bool]]:
    """(when it was found, still or not) at each change of telemetry's judgement on the wheels, judged again."""
    judge = StillJudge(incident.number("still.std_radps"))
    found: list[tuple[int, bool]] = []
    for sample in incident.imu:
        judge.take(sample.rate_radps[0], sample.rate_radps[1], sample.t_ns)
        still = judge.still_ns > 0
        if judge.judged_ns and sample.t_ns - incident.imu[0].t_ns >= FIRST_NS and (not found or found[-1][1] != still):
            found.append((sample.t_ns, still))
    return found


def proven(incident: Incident) -> dict[str, Any] | None:
    """How the stop was proven, as of memory.told_stop. Where the supervisor saw no shaking, since it was held up
    itself, the samples' word on when the wheels came to rest."""
    stop: dict[str, Any] | None = incident.head["stop"]
    if stop is None or stop.get("observed_ms") or stop.get("wheels") == "unstill":
        return stop
    found = verdicts(incident)
    turned = [still for ns, still in found if ns <= incident.cause_ns][-1:] == [False]
    rested = [ns for ns, still in found if still and ns > incident.cause_ns]
    # It is found so much later than it was.
    seen = {"observed_ms": max(LEAST_MS, incident.ms(rested[0] - FIRST_NS))} if turned and rested else {}
    return stop | seen


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
        return round(incident.number("gate.lease_s") * 1e9)
    return BY_NAME[process].deadline_ns


def silences(incident: Incident) -> list[Silence]:
    """Every silence that the supervisor saw, the oldest first; of its own, those that it noticed afterwards."""
    found = []
    for index, process in enumerate(layout.PROCESSES):
        beats = [(ns, *times[index]) for ns, times in incident.beats]
        allowed = allowed_ns(incident, process)
        seen = [(us * 1000 > allowed, ns - before_us * 1000, us * 1000) for ns, us, before_us in beats]
        for late, run in ((late, list(group)) for late, group in groupby(seen, itemgetter(0))):
            if late:
                found.append(Silence(process, run[0][1] - run[0][2], run[-1][1], ended=run[-1] is not seen[-1]))
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
    last_ns, end_ns = incident.ticks[-1].ns, incident.span_ns[1]
    if end_ns - last_ns > allowed:
        parts.append((SILENT, last_ns, end_ns))
    runs = [(what, list(run)) for what, run in groupby(parts, itemgetter(0))]
    return [(what, run[0][1], run[-1][2]) for what, run in runs]


class Joint(NamedTuple):
    """One servo of the arm over time, in pulses."""

    servo: int
    name: str
    """Of the settings; empty: they name none."""
    sent: Points
    """Where it was sent."""
    read: Points
    """Where it said that it was."""
    goals: Points
    """Where it was to be, of trajectories (their ends) and follow; a rate is no place."""


def joints(incident: Incident) -> list[Joint]:
    """Each servo that was sent somewhere or read, by its number."""
    parts = ((key.split("."), value) for key, value in incident.settings.items())
    names = {int(value): key[1] for key, value in parts if key[0] == "joints" and key[2:] == ["servo"]}
    found: dict[int, Joint] = {}

    def of(servo: int) -> Joint:
        return found.setdefault(servo, Joint(servo, names.get(servo, ""), [], [], []))

    for write in incident.writes:
        head = write.head
        if write.taken and len(head) > MOVES_AT and head[2] == framing.BUS_SERVO and head[4] == servos.MOVE:
            for at in range(MOVES_AT, min(MOVES_AT + 3 * head[7], len(head) - 3), 3):
                of(head[at]).sent.append((write.ns, head[at + 1] | head[at + 2] << 8))
    for ns, servo, pulses in incident.servo_positions:
        of(servo).read.append((ns, pulses))
    for ns, (mode, _, aims) in incident.arm_goals:
        for servo, aim in aims.items() if mode in ("trajectory", "follow") else ():
            of(servo).goals.append((ns, aim))
    return sorted(found.values())


def wheel_ids(incident: Incident) -> tuple[int, ...]:
    """The wire id of each of WHEELS."""
    return tuple(int(incident.number(f"wheels.id_{number}")) for number in (1, 2, 3, 4))

"""The story: what happened around a stop, as lines in the order of time, what repeats told once; and of these lines
those that say at a glance what led to it and what came of it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TypeVar

from failstop.incidents import memory
from failstop.incidents.incident import DRIVING, SAYS, SILENT, Incident, Sort, Tick, Write
from failstop.shm import layout

Entry = TypeVar("Entry")

CAUSE = "CAUSE"
DETAIL_NS = 500_000_000
"""This long before the cause and after it every change is told; what is older, in broad strokes."""
QUIET_NS = 100_000_000
"""A board that sends 110 IMU samples a second and then nothing for this long has gone silent."""
TELL_OF_STOPS = frozenset(("stop", "stop_again", "stop_also"))
"""Events that tell of a stop's cause."""
NO_NEWS = frozenset(
    ("stop_outcome", "stop_also", "incident", "restarting", "gyro", "charger", "ready", "link", "battery", "stopping")
)
"""Events that the facts have already, or that are of no use for the question why."""
FRAMES = {
    Sort.ZERO: "zero frame{}",
    Sort.ARM: "frame{} for the arm",
    Sort.PING: "ping{}, which the board answers",
    Sort.REST: "the rest of it",
}
"""Sorts of which one is like another."""
MOST_LINES = 10
"""Of a summary: with the facts above them they fit a terminal of 24 lines."""
BEGINNINGS = ("reset", "ready")
"""What was before the last of these belongs to an earlier stop."""
LESSER = ("gate", "command")
"""The first to make room: the facts have the most of it."""


@dataclass(frozen=True)
class Line:
    """One line. `what` is who speaks: command, gate, arm, wire, board, beat, wheels, event kinds, CAUSE."""

    ns: int
    what: str
    text: str
    until_ns: int = 0
    """The last of several that this line stands for; 0: one."""
    count: int = 1
    routine: bool = False
    """It leads nowhere, or the facts have it already: the summary goes without."""


def tell(incident: Incident, detail_ns: int = DETAIL_NS) -> list[Line]:
    """Every line, in order; what was at the same time in the order of the stop's way. `detail_ns`: this long before the
    cause and after it every change is told; else in broad strokes."""
    lines = [
        *_commands(incident, detail_ns),
        *_decisions(incident),
        _cause(incident),
        *_arm(incident),
        *_writes(incident, detail_ns),
        *_board(incident),
        *_wheels(incident),
        *_silences(incident),
        *_events(incident),
    ]
    return sorted(lines, key=lambda line: line.ns)


def within(lines: list[Line], since_ns: int) -> list[Line]:
    """The lines from a moment on; what has begun before it and goes on is told as of then."""
    there = (line for line in lines if max(line.ns, line.until_ns) >= since_ns)
    return [line if line.ns >= since_ns else replace(line, ns=since_ns) for line in there]


def brief(incident: Incident, since_ns: int) -> list[Line]:
    """The lines that matter, in broad strokes, in order and in few words; `since_ns`: nothing older."""
    lines = tell(incident, 0)
    begins = [line.ns for line in lines if line.what in BEGINNINGS and since_ns <= line.ns < incident.cause_ns]

    def weight(line: Line) -> tuple[bool, bool, int]:
        early = line.what == "wheels" and line.ns < incident.cause_ns
        return line.what != CAUSE, early or line.what in LESSER, abs(line.ns - incident.cause_ns)

    found = [line for line in within(lines, max([since_ns, *begins])) if not line.routine]
    kept = sorted(sorted(found, key=weight)[:MOST_LINES], key=lambda line: (line.ns, line.what not in BEGINNINGS))
    return [replace(line, text=incident.why if line.what == CAUSE else _short(line.text)) for line in kept]


def _short(text: str) -> str:
    """Without what to do next, and what was before."""
    return text.partition("; next: ")[0].partition(" (was: ")[0]


def noticed_by(incident: Incident) -> str:
    """The process that noticed the cause, for people; empty: not known."""
    noticed = [by for ns, by, _ in incident.stops if ns == incident.cause_ns]
    return name((incident.head["stop"] or {}).get("noticed_by") or (noticed[0] if noticed else ""))


def name(process: str) -> str:
    """A process, for people."""
    return process.replace("_", " ")


def velocity(values: tuple[float, float, float]) -> str:
    """For people: forward, left and turn, those that are not zero."""
    named = zip(("vx", "vy", "wz"), values, ("m/s", "m/s", "rad/s"), strict=True)
    return ", ".join(f"{axis} {value:+.2f} {unit}" for axis, value, unit in named if value) or "zero"


def _cause(incident: Incident) -> Line:
    by = noticed_by(incident)
    return Line(incident.cause_ns, CAUSE, f"{incident.reason}{f'; noticed by the {by}' if by else ''}")


def _runs(entries: Iterable[Entry], key: Callable[[Entry], object]) -> Iterator[list[Entry]]:
    """Neighbours of one key."""
    return (list(group) for _, group in groupby(entries, key))


def _steps(values: tuple[float, ...] | None) -> str:
    """What is told of its own near the cause: a change of about 0.1 (m/s, rad/s, rps)."""
    return " ".join(f"{value:.1f}" for value in values or ())


def _commands(incident: Incident, detail_ns: int) -> Iterator[Line]:
    """Who commanded what."""

    def lane(tick: Tick) -> tuple[str, str, bool]:
        return tick.who, tick.source, tick.manual

    def key(tick: Tick) -> object:
        return lane(tick), abs(tick.ns - incident.cause_ns) < detail_ns and _steps(tick.command)

    heard = [tick for tick in incident.ticks if tick.commands and tick.age_us is not None]
    for run in _runs(sorted(heard, key=lane), key):
        first = run[0]
        text = velocity(first.command)
        if len(what := {tick.command for tick in run}) > 1:
            lows, highs = (" ".join(f"{f(axis):+.2f}" for axis in zip(*what, strict=True)) for f in (min, max))
            text = f"between ({lows}) and ({highs})"
        who = f"{first.who} as {first.source}{', manual' if first.manual else ''}"
        said = f"{who}: {text}" if detail_ns else f"{first.who} commands"
        yield Line(first.ns, "command", said, run[-1].ns, sum(tick.commands for tick in run))


def _decisions(incident: Incident) -> Iterator[Line]:
    """Each time the gate decided otherwise, or nothing."""
    for what, begin_ns, end_ns in incident.gate_spans():
        said = "lets the wheels turn" if what == DRIVING else f"blocks: {SAYS.get(what, what)}"
        silent = f"no tick for {(end_ns - begin_ns) / 1e6:.0f} ms from here"
        yield Line(begin_ns, "gate", silent if what == SILENT else said)


def _arm(incident: Incident) -> Iterator[Line]:
    """For whom it moved, and where each joint was read to be for the first time after the cause."""
    joints = incident.joints()
    names = {joint.servo: joint.name or joint.servo for joint in joints}
    for run in _runs(incident.arm_goals, lambda goal: goal[1][:2]):
        until_ns, (mode, who, last) = run[-1]
        unit = "/s" if mode == "jog" else ""
        aims = ", ".join(f"{names.get(servo, servo)} {aim:.0f}{unit}" for servo, aim in last.items())
        text = f"{mode} for {who}" + (f", last: {aims}" if aims else "") if mode else "moved by nobody"
        yield Line(run[0][0], "arm", text, until_ns, len(run))
    for joint in joints:
        if after := [(ns, pulses) for ns, pulses in joint.read if ns >= incident.cause_ns]:
            yield Line(after[0][0], "arm", f"{names[joint.servo]} ({joint.servo}) is read to be at {after[0][1]}")


def _writes(incident: Incident, detail_ns: int) -> Iterator[Line]:
    """What went to the board: bursts one by one, frames of one sort together. The summary has those after the cause but
    for routine, and what the port did not take."""

    def lane(write: Write) -> tuple[str, str]:
        # What sets no speed comes between all that does, and would cut every run.
        return ("", "") if write.speeds_rps and detail_ns else (write.sort, write.by)

    def key(write: Write) -> object:
        alone = str(write.ns) if write.sort == Sort.STOP_BURST else _steps(write.speeds_rps)
        near = alone if abs(write.ns - incident.cause_ns) < detail_ns and write.speeds_rps else ""
        return write.sort, write.by, write.ns >= incident.cause_ns, near, write.taken < write.length

    for run in _runs(sorted(incident.writes, key=lane), key):
        first, last = run[0], run[-1]
        text = _written(first, last, len(run))
        routine = first.ns < incident.cause_ns or first.sort in (Sort.ZERO, Sort.PING)
        if first.taken < first.length:
            text, routine = f"{text}; the port took {first.taken} of {first.length} bytes", False
        yield Line(first.ns, "wire", text, last.ns, len(run), routine)


def _written(first: Write, last: Write, count: int) -> str:
    if first.sort == Sort.STOP_BURST:
        return f"STOP BURST by the {name(first.by)}"
    if first.sort == Sort.MOTION:
        speeds = " ".join(f"{speed:+.3f}" for speed in last.speeds_rps or ())
        return f"motion{'' if first.head == last.head else ', last'} [{speeds}] rps"
    if first.sort in FRAMES:
        return FRAMES[first.sort].format("s" if count > 1 else "")
    return f"frame {first.head[:12].hex(' ')}{' ...' * (first.length > 12)}"


def _board(incident: Incident) -> Iterator[Line]:
    """How long the board was heard; its silences."""
    times = [ns for ns, _ in incident.received] or [sample.t_ns for sample in incident.imu]
    if not times:
        return
    size = sum(len(data) for _, data in incident.received)
    yield Line(times[0], "board", f"is heard{f', {size} bytes' if size else ''}", times[-1], len(times), routine=True)
    end_ns = incident.span_ns[1]
    for earlier, later in pairwise([*times, end_ns]):
        if later - earlier > QUIET_NS:
            silent = "silent for {} ms from here" if later != end_ns else "its last byte; silent until the end, {} ms"
            yield Line(earlier, "board", silent.format(f"{(later - earlier) / 1e6:.0f}"))


def _wheels(incident: Incident) -> Iterator[Line]:
    """What the IMU says."""
    for ns, still in incident.verdicts():
        yield Line(ns, "wheels", f"the IMU says: {'still' if still else 'they turn'}")


def _silences(incident: Incident) -> Iterator[Line]:
    """Of each process; of a run that has ended, its last sign of life."""
    for silence in incident.silences():
        lasted = f"{'' if silence.ended else 'at least '}{(silence.until_ns - silence.since_ns) / 1e6:.0f} ms"
        said = f"last beat of the {name(silence.process)} for {lasted}"
        yield Line(silence.since_ns, "beat", said, silence.until_ns)
    for process in layout.PROCESSES if incident.head["kind"] == "left" else ():
        if last_ns := incident.words(process).get("beat_ns"):
            yield Line(last_ns, "beat", f"the last beat of the {name(process)}")


def _events(incident: Incident) -> Iterator[Line]:
    """What was told; causes of which nothing was."""
    for event in incident.events:
        text = f"{'! ' if event.level in ('error', 'critical') else ''}{event.text}"
        # Of the stop itself the summary has the facts.
        own = event.text.partition(": ")[2].startswith(incident.reason) and event.ns >= incident.cause_ns
        routine = own if event.kind == "stop" else event.kind in NO_NEWS
        yield Line(event.ns, event.kind, text, routine=routine)
    stops = [event.fields for event in incident.events if event.kind in TELL_OF_STOPS]
    for ns, by, cause in incident.stops:
        if ns != incident.cause_ns and not any(memory.tells_of(fields, cause) for fields in stops):
            yield Line(ns, "cause", f"{cause} (noticed by the {name(by)})")

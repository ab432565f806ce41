"""The story: what happened around a stop, as lines in the order of time, what is alike told once; and of these lines
those that say at a glance what led to it and what came of it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from failstop.api import words
from failstop.incidents.incident import DRIVING, QUIET_NS, SAYS, SILENT, Incident, PortWrite, Tick, WriteSort, named
from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.processes import PROCESS_BY_NAME

if TYPE_CHECKING:
    from failstop.policy.causes import Cause

Entry = TypeVar("Entry")
CAUSE = "CAUSE"
PAUSE_NS = 1_000_000_000
"""What repeats is one line until it pauses for longer than this: another drive, or another stop, is another line."""
NO_NEWS = frozenset(
    ("stop_outcome", "stop_also", "incident", "restarting", "gyro", "charger", "ready", "link", "battery", "stopping")
)
"""Events that the facts have already, or that are of no use for the question why."""
FRAMES = {
    WriteSort.ZERO: "zero frames",
    WriteSort.ARM: "frames for the arm",
    WriteSort.PING: "pings, which the board answers",
    WriteSort.REST: "the rest of what the port had not taken",
}
"""Sorts of which one is like another."""
MOST_LINES = 10
"""At a glance: with the facts above them they fit a terminal of 24 lines."""
BEGINNINGS = ("reset", "ready")
"""Events before the last of these belong to an earlier stop."""
KEPT = ("enabled", "command")
"""The newest of each before the cause is never left out: which program enabled motion, and which one drove."""
LESSER = ("gate", "command")
"""The first to make room: the facts have the most of it."""


@dataclass(frozen=True)
class Line:
    """One line. `what` is who speaks: command, gate, arm, wire, board, beat, event kinds, cause, CAUSE."""

    ns: int
    what: str
    text: str
    """The event. If several alike are one line: the last of them."""
    until_ns: int = 0
    """When what began at `ns` was last seen; 0: it was a moment."""
    count: int = 1
    routine: bool = False
    """It leads nowhere, or the facts have it already: at a glance nobody misses it."""


def whole(incident: Incident) -> list[Line]:
    """Every line, in order; what was at the same time in the order of the stop's way."""
    lines = [
        *_commands(incident),
        *_decisions(incident),
        Line(incident.cause_ns, CAUSE, incident.why),
        *_arm(incident),
        *_writes(incident),
        *_board(incident),
        *_wheels(incident),
        *_silences(incident),
        *_events(incident),
    ]
    return sorted(lines, key=lambda line: line.ns)


def brief(incident: Incident) -> list[Line]:
    """The lines that matter: the nearest to the cause, in order, and none of what was over before the last reset."""
    lines, cause_ns = whole(incident), incident.cause_ns
    begun_ns = max((line.ns for line in lines if line.what in BEGINNINGS and line.ns < cause_ns), default=0)

    found = [line for line in lines if not line.routine and max(line.ns, line.until_ns) >= begun_ns]
    kept = [{line.what: line for line in found if line.ns < cause_ns}.get(what) for what in KEPT]

    def weight(line: Line) -> tuple[bool, bool, int]:
        away_ns = min(abs(ns - cause_ns) for ns in (line.ns, line.until_ns or line.ns))
        return line.what != CAUSE and line not in kept, line.what in LESSER, away_ns

    return sorted(sorted(found, key=weight)[:MOST_LINES], key=lambda line: line.ns)


def _unbroken(entries: list[Entry], at_ns: Callable[[Entry], int]) -> Iterator[list[Entry]]:
    """Entries in the order of time, as runs without a pause."""
    run: list[Entry] = []
    for entry in entries:
        if run and at_ns(entry) - at_ns(run[-1]) > PAUSE_NS:
            yield run
            run = []
        run.append(entry)
    if run:
        yield run


def _commands(incident: Incident) -> Iterator[Line]:
    """Commands and their sources, before the cause and after it."""

    def key(tick: Tick) -> tuple[str, str, bool, bool]:
        return tick.who, tick.source, tick.manual, tick.ns >= incident.cause_ns

    heard = [tick for tick in incident.ticks if tick.commands and tick.age_us is not None]
    for _, group in groupby(sorted(heard, key=key), key):
        for run in _unbroken(list(group), lambda tick: tick.ns):
            last = run[-1]
            how = words.velocity(*last.command) or "zero"
            said = f"{last.who} as {last.source}{', manual' * last.manual}: {how}"
            yield Line(run[0].ns, "command", said, last.ns, sum(tick.commands for tick in run))


def _decisions(incident: Incident) -> Iterator[Line]:
    """Each time the gate decided otherwise, or nothing."""
    for what, begin_ns, end_ns in incident.gate_spans():
        said = "lets the wheels turn" if what == DRIVING else f"blocks: {SAYS.get(what, what)}"
        silent = f"no tick for {(end_ns - begin_ns) / 1e6:.0f} ms from here"
        yield Line(begin_ns, "gate", silent if what == SILENT else said)


def _arm(incident: Incident) -> Iterator[Line]:
    """For whom it moved, and where it was to be."""
    for _, group in groupby(incident.arm_goals, lambda goal: goal[1][:2]):
        for run in _unbroken(list(group), lambda goal: goal[0]):
            until_ns, (mode, who, aims) = run[-1]
            unit = "/s" if mode == "jog" else ""
            told = ", ".join(f"{incident.joint(servo)} {aim:.0f}{unit}" for servo, aim in aims.items())
            text = f"{mode} for {who}: {told}" if mode else "moved by nobody"
            yield Line(run[0][0], "arm", text, until_ns, len(run))


def _writes(incident: Incident) -> Iterator[Line]:
    """Writes to the board, by their sort. At a glance, what came after the cause, and what the port did not take."""

    def key(numbered: tuple[int, PortWrite]) -> tuple[str, int, str, bool, bool]:
        drive, write = numbered
        return write.sort, drive, write.by, write.ns >= incident.cause_ns, write.taken < write.length

    for _, group in groupby(sorted(_by_drive(incident.writes), key=key), key):
        writes = [write for _, write in group]
        # Zeros and pings go out all the time, so a pause between them ends nothing.
        usual = writes[0].sort in (WriteSort.ZERO, WriteSort.PING)
        for run in [writes] if usual else _unbroken(writes, lambda write: write.ns):
            first, last = run[0], run[-1]
            text, routine = _written(last), first.ns < incident.cause_ns or usual
            if last.taken < last.length:
                text, routine = f"{text}; the port took {last.taken} of {last.length} bytes", False
            yield Line(first.ns, "wire", text, last.ns, len(run), routine)


def _by_drive(writes: list[PortWrite]) -> Iterator[tuple[int, PortWrite]]:
    """Motion frames and bursts with the number of their drive, which ends with the first write that tells the wheels to
    stop; 0 for the others."""
    drive, moves = 0, False
    for write in writes:
        if write.sort == WriteSort.MOTION:
            drive, moves = drive + (not moves), True
        elif write.sort in (WriteSort.ZERO, WriteSort.STOP_BURST):
            moves = False
        yield drive if write.sort in (WriteSort.MOTION, WriteSort.STOP_BURST) else 0, write


def _written(write: PortWrite) -> str:
    if write.sort == WriteSort.STOP_BURST:
        return f"STOP BURST by the {named(write.by)}"
    if write.sort == WriteSort.MOTION:
        return f"motion [{' '.join(f'{speed:+.3f}' for speed in write.speeds_rps or ())}] rps"
    return FRAMES.get(write.sort) or f"frame {write.head[:12].hex(' ')}{' ...' * (write.length > 12)}"


def _board(incident: Incident) -> Iterator[Line]:
    """Its silences."""
    times = [ns for ns, _ in incident.received] or [sample.t_ns for sample in incident.imu]
    for earlier, later in pairwise([*times, incident.span_ns[1]] if times else ()):
        lost = any(earlier < since_ns <= later for since_ns in incident.received_from_ns)
        if later - earlier > QUIET_NS and not lost:
            yield Line(earlier, "board", f"silent for {(later - earlier) / 1e6:.0f} ms from here", later)


def _wheels(incident: Incident) -> Iterator[Line]:
    """Each time the board's reports said that they turn, or are still; and the gaps in which it reported nothing."""
    spans = incident.rolled()
    for turn, begin_ns, end_ns, fastest_rps, count in spans:
        said = f"seen turning, max {fastest_rps:.2f} turns/s" if turn else "seen still"
        yield Line(begin_ns, "wheels", said, end_ns, count)
    for (_, _, from_ns, _, _), (_, until_ns, _, _, _) in pairwise(spans):
        if until_ns - from_ns > incident.wheels_gap_ns:
            text = f"no report for {(until_ns - from_ns) / 1e6:.0f} ms from here"
            yield Line(from_ns, "wheels", text, until_ns, routine=until_ns < incident.cause_ns)


def _silences(incident: Incident) -> Iterator[Line]:
    """A line for each silence of a process. If the run has ended, also one for each process's last sign of life."""
    for process, since_ns, until_ns in incident.silences():
        said = f"last beat of the {named(process)} for {(until_ns - since_ns) / 1e6:.0f} ms"
        yield Line(since_ns, "beat", said, until_ns)
    for process in layout.PROCESS_NAMES if incident.left else ():
        if last_ns := incident.words(process).get("beat_ns"):
            yield Line(last_ns, "beat", f"the last beat of the {named(process)}")


def _events(incident: Incident) -> Iterator[Line]:
    """Events; and of a run that has ended, the causes that nobody was there to tell of."""
    for event in incident.events:
        # Of the stop itself the facts tell.
        own = event.fields.get("cause") == incident.cause.kind.name and event.ns >= incident.cause_ns
        routine = own if event.kind == "stop" else event.kind in NO_NEWS
        mark = "! " * (event.level in ("error", "critical"))
        yield Line(event.ns, event.kind, f"{mark}{event.what}", routine=routine)
    for ns, by, cause in incident.stops if incident.left else ():
        if ns > incident.cause_ns:
            yield Line(ns, "cause", f"{_ended(incident, cause) or cause} (noticed by the {named(by)})")


def _ended(incident: Incident, cause: Cause) -> str:
    """What to say of a process that the kernel ends when the supervisor dies, as it does by design; empty: the cause is
    another one."""
    process = PROCESS_BY_NAME.get(str(cause.named().get("process")))
    by_design = process and not process.outlives_supervisor and cause.kind is causes.DIED
    if not by_design or incident.cause != causes.DIED(layout.SUPERVISOR):
        return ""
    return f"{process.name} ended with the supervisor, by design" if process else ""


def as_dict(incident: Incident) -> dict[str, Any]:
    """For programs: the head, the whole story, the machine, and every setting."""
    lines = [
        {"ms": round(incident.ms(line.ns), 3), "what": line.what, "text": line.text, "count": line.count}
        for line in whole(incident)
    ]
    found = {"id": incident.id, **incident.head, "story": lines, "ages": incident.ages()}
    return {**found, "machine": incident.machine, "settings": incident.settings}

"""Story: tells what happened around a stop, as lines in the order of time. Repeated events share a line. brief() picks
the lines that show at a glance what led to the stop and what followed. Pure."""

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
"""After a pause longer than this, a repeated event gets a new line, because it is then another drive or another
stop."""
NO_NEWS = frozenset(
    ("stop_outcome", "stop_also", "incident", "restarting", "gyro", "charger", "ready", "link", "battery", "stopping")
)
"""Kinds of events that brief() leaves out. Either the summary above the story has them already, or they don't help to
explain the stop."""
FRAMES = {
    WriteSort.ZERO: "zero frames",
    WriteSort.ARM: "frames for the arm",
    WriteSort.PING: "pings, which the board answers",
    WriteSort.REST: "the rest of what the port had not taken",
}
"""The text for kinds of writes whose frames are all alike, so that their bytes need not be shown."""
MOST_LINES = 10
"""How many lines brief() returns. With the summary above them, they fit a terminal of 24 lines."""
BEGINNINGS = ("reset", "ready")
"""Kinds of events that begin a new chapter. Whatever ended before the last of these events belongs to an earlier
stop."""
KEPT = ("enabled", "command")
"""The newest line of each of these kinds before the cause is always in brief(). They show which program enabled motion,
and which program drove."""
LESSER = ("gate", "command")
"""Kinds of lines that brief() drops first, because the summary above the story has most of their content."""


@dataclass(frozen=True)
class Line:
    """One line of the story. `what` is its subject: command, gate, arm, wire, board, wheels, beat, the kind of an
    event, cause, or CAUSE for the cause of this incident."""

    ns: int
    what: str
    text: str
    """What happened. If the line stands for several similar events, this describes the last one."""
    until_ns: int = 0
    """When something that began at `ns` was last seen. 0 if it was only a moment."""
    count: int = 1
    routine: bool = False
    """True if brief() may leave the line out, because it explains nothing or because the summary above the story has it
    already."""


def whole(incident: Incident) -> list[Line]:
    """All lines, in the order of time. Lines with the same time are in the order in which a stop passes through the
    system."""
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
    """The most important lines near the cause, at most MOST_LINES, in the order of time. Lines that ended before the
    last reset or start are left out."""
    lines, cause_ns = whole(incident), incident.cause_ns
    begun_ns = max((line.ns for line in lines if line.what in BEGINNINGS and line.ns < cause_ns), default=0)

    found = [line for line in lines if not line.routine and max(line.ns, line.until_ns) >= begun_ns]
    kept = [{line.what: line for line in found if line.ns < cause_ns}.get(what) for what in KEPT]

    def weight(line: Line) -> tuple[bool, bool, int]:
        away_ns = min(abs(ns - cause_ns) for ns in (line.ns, line.until_ns or line.ns))
        return line.what != CAUSE and line not in kept, line.what in LESSER, away_ns

    return sorted(sorted(found, key=weight)[:MOST_LINES], key=lambda line: line.ns)


def _unbroken(entries: list[Entry], at_ns: Callable[[Entry], int]) -> Iterator[list[Entry]]:
    """Split entries, which must be in the order of time, at each pause longer than PAUSE_NS."""
    run: list[Entry] = []
    for entry in entries:
        if run and at_ns(entry) - at_ns(run[-1]) > PAUSE_NS:
            yield run
            run = []
        run.append(entry)
    if run:
        yield run


def _commands(incident: Incident) -> Iterator[Line]:
    """The commands of each source, before the cause and after it."""

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
    """A line for each new decision of the gate, and for each time in which it was silent."""
    for what, begin_ns, end_ns in incident.gate_spans():
        said = "lets the wheels turn" if what == DRIVING else f"blocks: {SAYS.get(what, what)}"
        silent = f"no tick for {(end_ns - begin_ns) / 1e6:.0f} ms from here"
        yield Line(begin_ns, "gate", silent if what == SILENT else said)


def _arm(incident: Incident) -> Iterator[Line]:
    """Who moved the arm, and where to."""
    for _, group in groupby(incident.arm_goals, lambda goal: goal[1][:2]):
        for run in _unbroken(list(group), lambda goal: goal[0]):
            until_ns, (mode, who, aims) = run[-1]
            unit = "/s" if mode == "jog" else ""
            told = ", ".join(f"{incident.joint(servo)} {aim:.0f}{unit}" for servo, aim in aims.items())
            text = f"{mode} for {who}: {told}" if mode else "moved by nobody"
            yield Line(run[0][0], "arm", text, until_ns, len(run))


def _writes(incident: Incident) -> Iterator[Line]:
    """The writes to the board, by kind. Zero frames, pings and writes before the cause are routine, unless the port
    took only a part of them."""

    def key(numbered: tuple[int, PortWrite]) -> tuple[str, int, str, bool, bool]:
        drive, write = numbered
        return write.sort, drive, write.by, write.ns >= incident.cause_ns, write.taken < write.length

    for _, group in groupby(sorted(_by_drive(incident.writes), key=key), key):
        writes = [write for _, write in group]
        # Zeros and pings are sent all the time, so a pause does not split them.
        usual = writes[0].sort in (WriteSort.ZERO, WriteSort.PING)
        for run in [writes] if usual else _unbroken(writes, lambda write: write.ns):
            first, last = run[0], run[-1]
            text, routine = _written(last), first.ns < incident.cause_ns or usual
            if last.taken < last.length:
                text, routine = f"{text}; the port took {last.taken} of {last.length} bytes", False
            yield Line(first.ns, "wire", text, last.ns, len(run), routine)


def _by_drive(writes: list[PortWrite]) -> Iterator[tuple[int, PortWrite]]:
    """Number the motion frames and stop bursts by the drive to which they belong. A drive ends with the first write
    that stops the wheels. All other writes get 0."""
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
    """The times in which the board was silent."""
    times = [ns for ns, _ in incident.received] or [sample.t_ns for sample in incident.imu]
    for earlier, later in pairwise([*times, incident.span_ns[1]] if times else ()):
        lost = any(earlier < since_ns <= later for since_ns in incident.received_from_ns)
        if later - earlier > QUIET_NS and not lost:
            yield Line(earlier, "board", f"silent for {(later - earlier) / 1e6:.0f} ms from here", later)


def _wheels(incident: Incident) -> Iterator[Line]:
    """A line for each period in which the board reported turning or still wheels, and for each gap in its reports."""
    spans = incident.rolled()
    for turn, begin_ns, end_ns, fastest_rps, count in spans:
        said = f"seen turning, max {fastest_rps:.2f} turns/s" if turn else "seen still"
        yield Line(begin_ns, "wheels", said, end_ns, count)
    for (_, _, from_ns, _, _), (_, until_ns, _, _, _) in pairwise(spans):
        if until_ns - from_ns > incident.wheels_gap_ns:
            text = f"no report for {(until_ns - from_ns) / 1e6:.0f} ms from here"
            yield Line(from_ns, "wheels", text, until_ns, routine=until_ns < incident.cause_ns)


def _silences(incident: Incident) -> Iterator[Line]:
    """A line for each silence of a process. If the run died, also a line for each process's last beat."""
    for process, since_ns, until_ns in incident.silences():
        said = f"last beat of the {named(process)} for {(until_ns - since_ns) / 1e6:.0f} ms"
        yield Line(since_ns, "beat", said, until_ns)
    for process in layout.PROCESS_NAMES if incident.left else ():
        if last_ns := incident.words(process).get("beat_ns"):
            yield Line(last_ns, "beat", f"the last beat of the {named(process)}")


def _events(incident: Incident) -> Iterator[Line]:
    """The logged events. If the run died, also the later causes that the port owner and the gate noticed."""
    for event in incident.events:
        # The summary above the story already shows the event of this stop.
        own = event.fields.get("cause") == incident.cause.kind.name and event.ns >= incident.cause_ns
        routine = own if event.kind == "stop" else event.kind in NO_NEWS
        mark = "! " * (event.level in ("error", "critical"))
        yield Line(event.ns, event.kind, f"{mark}{event.what}", routine=routine)
    for ns, by, cause in incident.stops if incident.left else ():
        if ns > incident.cause_ns:
            yield Line(ns, "cause", f"{_ended(incident, cause) or cause} (noticed by the {named(by)})")


def _ended(incident: Incident, cause: Cause) -> str:
    """The text for a process that ended by design, because the supervisor died. Empty for any other cause."""
    process = PROCESS_BY_NAME.get(str(cause.named().get("process")))
    by_design = process and not process.outlives_supervisor and cause.kind is causes.DIED
    if not by_design or incident.cause != causes.DIED(layout.SUPERVISOR):
        return ""
    return f"{process.name} ended with the supervisor, by design" if process else ""


def as_dict(incident: Incident) -> dict[str, Any]:
    """The incident for programs: its head, the whole story, the ages of readings, the machine, and all settings."""
    lines = [
        {"ms": round(incident.ms(line.ns), 3), "what": line.what, "text": line.text, "count": line.count}
        for line in whole(incident)
    ]
    found = {"id": incident.id, **incident.head, "story": lines, "ages": incident.ages()}
    return {**found, "machine": incident.machine, "settings": incident.settings}

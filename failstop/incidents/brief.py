"""Brief: of a story's lines those that say at a glance what led to the stop and what came of it. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE, Line, within

MOST_LINES = 10
"""With the facts above them they fit a terminal of 24 lines."""
BEGINNINGS = ("reset", "ready")
"""What was before the last of these belongs to an earlier stop."""
LEFT_OUT = frozenset(
    ("stop_outcome", "stop_also", "incident", "restarting", "gyro", "charger", "ready", "link", "battery", "stopping")
)
"""The facts have it already, or it is of no use for the question why."""
LESSER = frozenset(("gate", "command", "ready"))
"""The first to make room: the facts have the most of it."""
ROUTINE = ("zero frame", "pings")
"""What goes out to the board at all times. A motion frame after the cause is no routine."""


def choose(incident: Incident, lines: list[Line], since_ns: int) -> list[Line]:
    """The lines that matter, in order and in few words; `since_ns`: nothing older."""
    begins = [line.ns for line in lines if line.what in BEGINNINGS and since_ns <= line.ns < incident.cause_ns]
    first_ns = max([since_ns, *begins])
    wanted = [line for line in within(lines, first_ns) if _matters(incident, line)]
    merged = sorted(_merged(incident, wanted), key=lambda line: (line.ns, line.what not in BEGINNINGS))

    def weight(line: Line) -> tuple[bool, bool, int]:
        early = line.what == "wheels" and line.ns < incident.cause_ns
        return line.what != CAUSE, early or line.what in LESSER, abs(line.ns - incident.cause_ns)

    kept = sorted(merged, key=weight)[:MOST_LINES]
    return [replace(line, text=_shorter(incident, line)) for line in merged if line in kept]


def _matters(incident: Incident, line: Line) -> bool:
    if line.what == "wire":
        if "the port took" in line.text:
            return True
        return line.ns >= incident.cause_ns and not line.text.startswith(ROUTINE)
    if line.what == "board":
        return "silent" in line.text
    if line.what == "stop":
        return not line.text.partition(": ")[2].startswith(incident.reason) or line.ns < incident.cause_ns
    return line.what not in LEFT_OUT


def _merged(incident: Incident, lines: Iterable[Line]) -> list[Line]:
    """What is told again with the same words, or with another velocity by the same client, becomes one line; so do the
    bursts of one writer. Before the cause and after it apart."""
    found: list[Line] = []
    places: dict[object, int] = {}
    for line in lines:
        key = _key(line), line.ns >= incident.cause_ns
        if line.what not in ("command", "wire") or key not in places:
            places[key] = len(found)
            found.append(line)
            continue
        first = found[places[key]]
        until_ns = max(first.until_ns or first.ns, line.until_ns or line.ns)
        text = line.text if line.what == "command" else first.text
        found[places[key]] = replace(first, text=text, until_ns=until_ns, count=first.count + line.count)
    return found


def _key(line: Line) -> str:
    return line.text.partition(": ")[0] if line.what == "command" else line.text


def _shorter(incident: Incident, line: Line) -> str:
    """In one row of a terminal, if that can be."""
    if line.what == CAUSE:
        return incident.why
    if line.what == "command":
        return f"{line.text.rpartition(' as ')[0]} commands"
    if line.what == "gate":
        return line.text.partition(" (before: ")[0].partition(", ")[0]
    return line.text.partition("; next: ")[0].partition(" (was: ")[0]

"""Brief: of a story's lines those that say at a glance what led to the stop and what came of it. Pure."""

from __future__ import annotations

from dataclasses import replace

from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE, Line, within

MOST_LINES = 10
"""With the facts above them they fit a terminal of 24 lines."""
BEGINNINGS = ("reset", "ready")
"""What was before the last of these belongs to an earlier stop."""
LESSER = ("gate", "command")
"""The first to make room: the facts have the most of it."""
REPEATED = ("command", "wire")
"""What is told again in the same words becomes one line, before the cause and after it apart."""


def choose(incident: Incident, lines: list[Line], since_ns: int) -> list[Line]:
    """The lines that matter, in order and in few words; `since_ns`: nothing older."""
    begins = [line.ns for line in lines if line.what in BEGINNINGS and since_ns <= line.ns < incident.cause_ns]
    merged: dict[object, Line] = {}
    for number, line in enumerate(within(lines, max([since_ns, *begins]))):
        if not line.short:
            continue
        key = (line.what, line.short, line.ns >= incident.cause_ns) if line.what in REPEATED else number
        first = merged.get(key)
        if first:
            until_ns = max(first.until_ns or first.ns, line.until_ns or line.ns)
            line = replace(first, until_ns=until_ns, count=first.count + line.count)
        merged[key] = replace(line, text=line.short)

    def weight(line: Line) -> tuple[bool, bool, int]:
        early = line.what == "wheels" and line.ns < incident.cause_ns
        return line.what != CAUSE, early or line.what in LESSER, abs(line.ns - incident.cause_ns)

    found = sorted(merged.values(), key=lambda line: (line.ns, line.what not in BEGINNINGS))
    kept = sorted(found, key=weight)[:MOST_LINES]
    return [line for line in found if line in kept]

"""`failstop events`: lists the events since the service was started, and shows new ones as they happen."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from argparse import ArgumentParser, Namespace
from contextlib import suppress
from math import isfinite

from failstop.api import words
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.incidents.left import left, refusal
from failstop.supervisor.events import PREFIX, fitted
from failstop.supervisor.kinds import EVENT_KINDS

EXAMPLES = """\
failstop events                        # all events that the service remembers
failstop events --follow               # then new ones, until Ctrl-C
failstop events --since 10m --kind stop,died   # stops and deaths
failstop events --json | jq -r .text   # for programs
"""

AGAIN_S = 0.5
"""The time between two attempts to find a running service, in seconds."""
UNITS_S = {"s": 1, "m": 60, "min": 60, "h": 3600, "d": 86400}


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop events`."""
    add = parser.add_argument
    add("-f", "--follow", action="store_true", help="keep printing new events, even after the service restarts")
    add("--since", metavar="AGE", help="only events that are younger than AGE, for example 30s, 10m, 2h or 1d")
    add("--kind", metavar="KIND,...", help="only events of these kinds, for example stop,died,enabled")
    add("--json", action="store_true", help="print one JSON object per line")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. With --follow it runs until Ctrl-C. If no service is running at the start, it prints the last
    events of a dead run and raises NoService."""
    name = arguments.name
    since_ns = since(arguments.since, time.monotonic_ns()) if arguments.since else 0
    chosen = kinds(arguments.kind) if arguments.kind else None

    last: Event | None = None

    def show(events: list[Event]) -> None:
        nonlocal last
        for event in events:
            if last and not arguments.json:
                style.show(clock(last, event))
            last = event
            if event.ns < since_ns or (chosen is not None and event.kind not in chosen):
                continue
            if arguments.json:
                print(json.dumps(dataclasses.asdict(event)))
            else:
                style.show(rows(event, time.time(), columns))
        sys.stdout.flush()

    columns = style.width() if sys.stdout.isatty() else None
    try:
        log = EventLog(name)
        show(log.read())
    except NoService as error:
        # the last events of a service that has died and was not started again
        show(dead[1] if (dead := left(name)) else [])
        raise refusal(name, error) from None
    while arguments.follow:
        try:
            for event in log.follow():
                show([event])
        except NoService as error:
            print(fitted(f"{PREFIX}{error}; waiting for it", 2), file=sys.stderr, flush=True)
            log = _next_run(log)
    return 0


def _next_run(before: EventLog) -> EventLog:
    """Wait until the service is running again, and return the events of its new run. If the supervisor was killed, the
    old run can still be found for a moment, but its events were already shown."""
    while True:
        with suppress(FailstopError):
            if (log := EventLog(before.name)).run != before.run:
                return log
        time.sleep(AGAIN_S)


def clock(earlier: Event, later: Event) -> list[style.Line]:
    """Return a line about a jump of the wall clock between two events, or an empty list if it did not jump. Times of
    day from before a jump can't be compared with later times."""
    jumped_s = words.clock_jump(later.t - earlier.t, (later.ns - earlier.ns) / 1e9)
    return [[(f"-- {words.jumped(jumped_s)} --", style.WARN)]] if jumped_s else []


def rows(event: Event, now_s: float, columns: int | None) -> list[style.Line]:
    """Return an event as lines for people, wrapped to this many columns. If `columns` is None, the line is not
    wrapped."""
    line = summary.event(event, now_s)
    indent = sum(style.cells(text) for text, _ in line[:2])
    return [line] if columns is None else style.wrap(line, columns, indent if indent < columns // 2 else 2)


def kinds(text: str) -> frozenset[str]:
    """Return the kinds of events in a text such as `stop,died`. Raises FailstopError for an unknown kind."""
    found, known = frozenset(text.replace(" ", "").split(",")) - {""}, [kind.name for kind in EVENT_KINDS]
    if unknown := sorted(found.difference(known)):
        raise FailstopError(f"no events have the kind {', '.join(unknown)}; the kinds are {', '.join(known)}")
    return found


def since(text: str, now_ns: int) -> int:
    """Convert an age such as `10m` (ten minutes ago) to CLOCK_MONOTONIC in ns, because somebody may have set the wall
    clock since. Raises FailstopError if the text is not an age."""
    number = text.rstrip("dhimns")
    unit_s = UNITS_S.get(text[len(number) :])
    if unit_s and number.replace(".", "", 1).isdigit() and number.isascii():
        age_ns = float(number) * unit_s * 1e9
        return now_ns - round(age_ns) if isfinite(age_ns) else 0
    raise FailstopError(f"--since {text}: give an age, such as 30s, 10m, 2h or 1d")

"""`failstop events`: what the service has told since its start, and what it tells now."""

from __future__ import annotations

import dataclasses
import json
import sys
import time

from failstop.api import host
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import left, told
from failstop.supervisor.fold import PREFIX, fitted

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop events                        # all that the service still remembers
failstop events --follow               # and what comes, until Ctrl-C
failstop events --since 10m --kind stop,died
failstop events --json | jq -r .text   # for programs
"""

POLL_S = 0.1
AGAIN_S = 0.5


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop events`."""
    add = parser.add_argument
    add("-f", "--follow", action="store_true", help="go on with what comes, over restarts of the service too")
    add("--since", metavar="WHEN", help="an age (30s, 10m, 2h, 1d) or a time (14:03, 2026-11-21 14:03)")
    add("--kind", metavar="KIND,...", help="these alone, such as stop,died,enabled")
    add("--json", action="store_true", help="one object a line")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print events; with --follow until Ctrl-C."""
    chosen = _Chosen(arguments)
    try:
        log = EventLog(arguments.name)
        chosen.show(log.read())
    except NoService as error:
        chosen.show(_left(arguments.name))
        journal = host.journal(arguments.name)
        raise NoService(f"{error}{f'; what it told is in {journal}' if journal else ''}") from None
    while arguments.follow:
        try:
            chosen.show(log.read())
        except NoService as error:
            print(fitted(f"{PREFIX}{error}; waiting for it", 2), file=sys.stderr, flush=True)
            log = _again(arguments.name)
        time.sleep(POLL_S)
    return 0


def _left(name: str) -> list[Event]:
    """What a service told that has died and was not started again."""
    found = left.find(name)
    return found.events if found else []


def _again(name: str) -> EventLog:
    """The log of the next run, whenever it comes."""
    while True:
        try:
            return EventLog(name)
        except FailstopError:
            time.sleep(AGAIN_S)


class _Chosen:
    """The events that are asked for, in the form that is asked for."""

    def __init__(self, arguments: Namespace) -> None:
        """Raises FailstopError for options that mean nothing."""
        self._since_s = told.since(arguments.since, time.time()) if arguments.since else 0.0
        self._kinds = told.kinds(arguments.kind) if arguments.kind else None
        self._json = arguments.json
        self._terminal = sys.stdout.isatty()

    def show(self, events: list[Event]) -> None:
        """Print those of them that were chosen."""
        columns = style.width() if self._terminal else None
        for event in events:
            if event.t < self._since_s or (self._kinds is not None and event.kind not in self._kinds):
                continue
            if self._json:
                print(json.dumps(dataclasses.asdict(event)))
            else:
                style.show(told.rows(event, time.time(), columns))
        sys.stdout.flush()

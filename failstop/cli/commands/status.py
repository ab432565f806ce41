"""`failstop status`: one screen, live with --watch, or JSON."""

from __future__ import annotations

import json
import time

from failstop.api.errors import NoService
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop status                        # one screen
failstop status -w                     # live; q or Ctrl-C ends it
ssh -t robot failstop status -w        # from elsewhere
failstop status --json | jq .blocked   # for programs
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop status`."""
    how = parser.add_mutually_exclusive_group()
    how.add_argument("-w", "--watch", action="store_true", help="live, with velocity and vibration, until q or Ctrl-C")
    how.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the state."""
    if arguments.watch:
        from failstop.cli.commands import watch

        return watch.main(arguments)
    try:
        state = StateReader(arguments.name).read()
    except NoService as error:
        from failstop.cli.screen import left

        raise left.refusal(arguments.name, error) from None
    if arguments.json:
        print(json.dumps(state.as_dict(), indent=2))
        return 0
    style.show(summary.lines(state, time.time(), style.width(), EventLog(arguments.name).read()))
    return 0

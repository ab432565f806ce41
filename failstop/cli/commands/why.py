"""`failstop why`: what holds the wheels, what proves it, what to do - a line each."""

from __future__ import annotations

import json
import time

from failstop.api.errors import NoService
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.api.why import Why, explain
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop why                           # what holds the wheels, since when
failstop why --json | jq -r '.do[]'  # the steps alone
"""

MOST_COLUMNS = 100
"""Longer lines are hard to read."""
LABEL = 7


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop why`."""
    parser.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the lines."""
    found, code = _explain(arguments.name)
    if arguments.json:
        print(json.dumps(found.as_dict(), indent=2))
        return code
    columns = min(style.width(), MOST_COLUMNS)
    for label, text in found.rows():
        style.show(style.wrap([(f"{label:<{LABEL}}", style.DIM), *summary.commands(text)], columns, LABEL))
    return code


def _explain(name: str) -> tuple[Why, int]:
    """The answer, and the exit code. Raises NoService where nothing is left of a service either."""
    try:
        state = StateReader(name).read()
        return explain(state, EventLog(name).read(), time.time()), 0
    except NoService as error:
        from failstop.cli.screen import left

        if found := left.find(name):
            return found.why(time.time()), error.exit_code
        raise left.refusal(name, error) from None

"""`failstop why`: one paragraph on what holds the wheels, and what to do."""

from __future__ import annotations

import json
import time

from failstop.api.errors import NoService
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import paragraph, summary

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop why                           # what holds the wheels, since when
failstop why --json | jq -r '.next[]'  # the steps alone
"""

MOST_COLUMNS = 100
"""Longer lines are hard to read."""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop why`."""
    parser.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the paragraph."""
    found, code = _explain(arguments.name)
    if arguments.json:
        print(json.dumps(found.as_dict(), indent=2))
        return code
    columns = min(style.width(), MOST_COLUMNS)
    style.show(style.wrap(summary.commands(found.text), columns, 0))
    return code


def _explain(name: str) -> tuple[paragraph.Explanation, int]:
    """The answer, and the exit code. Raises NoService where nothing is left of a service either."""
    try:
        state = StateReader(name).read()
        return paragraph.explain(state, EventLog(name).read(), time.time()), 0
    except NoService as error:
        from failstop.cli.screen import left

        if found := left.find(name):
            return paragraph.gone(found, time.time()), error.exit_code
        raise left.refusal(name, error) from None

"""`failstop why`: one paragraph on what holds the wheels, and what to do."""

from __future__ import annotations

import json
import time

from failstop import style
from failstop.commands import add_name
from failstop.events import EventLog
from failstop.screen import paragraph, summary
from failstop.state import StateReader

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop why                         # what holds the wheels, since when, what to do
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
    state = StateReader(arguments.name).read()
    found = paragraph.explain(state, EventLog(arguments.name).read(), time.time())
    if arguments.json:
        print(json.dumps(found.as_dict(), indent=2))
        return 0
    columns = min(style.width(), MOST_COLUMNS)
    style.show(style.wrap(summary.commands(found.text), columns, 0))
    return 0

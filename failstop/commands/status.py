"""`failstop status`: one screen, or JSON."""

from __future__ import annotations

import json
import time

from failstop import style
from failstop.commands import add_name
from failstop.screen import summary
from failstop.state import StateReader

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop status                        # one screen; `failstop watch` is the same, live
failstop status --json | jq .blocked   # for programs
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop status`."""
    parser.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the state."""
    state = StateReader(arguments.name).read()
    if arguments.json:
        print(json.dumps(state.as_dict(), indent=2))
        return 0
    style.show(summary.lines(state, time.time(), style.width()))
    return 0

"""`failstop status`, one screen, live as `failstop watch`; `failstop why`, what holds the wheels in a few lines."""

from __future__ import annotations

import json
import time
from argparse import ArgumentParser, Namespace

from failstop.api.errors import NoService
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.api.why import explain
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import runs, summary

EXAMPLES = {
    "status": """\
failstop status                        # one screen
failstop status -w                     # live; q or Ctrl-C ends it
ssh -t robot failstop status -w        # from elsewhere
failstop status --json | jq .blocked   # for programs
""",
    "watch": """\
failstop watch                        # q or Ctrl-C ends it
ssh -t robot failstop watch           # from elsewhere
""",
    "why": """\
failstop why                           # what holds the wheels, since when
failstop why --json | jq -r '.do[]'  # the steps alone
""",
}

PERIOD_S = 0.1
MOST_COLUMNS = 100
"""Of the lines of `why`: longer ones are hard to read."""
LABEL = 7


def add_arguments(parser: ArgumentParser) -> None:
    """Options of the three."""
    command = parser.prog.rpartition(" ")[2]
    parser.set_defaults(watch=command == "watch")
    how = parser.add_mutually_exclusive_group()
    if command == "status":
        live = "live, with velocity and vibration, until q or Ctrl-C"
        how.add_argument("-w", "--watch", action="store_true", help=live)
    if command != "watch":
        how.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print what is asked for, or watch. Raises NoService with what is left of a service that died."""
    if arguments.watch:
        return _watch(arguments.name)
    return (_why if arguments.command == "why" else _status)(arguments.name, as_json=arguments.json)


def _status(name: str, *, as_json: bool) -> int:
    try:
        state = StateReader(name).read()
    except NoService as error:
        raise runs.refusal(name, error) from None
    if as_json:
        print(json.dumps(state.as_dict(), indent=2))
    else:
        style.show(summary.lines(state, time.time(), style.width(), EventLog(name).read()))
    return 0


def _why(name: str, *, as_json: bool) -> int:
    code = 0
    try:
        found = explain(StateReader(name).read(), EventLog(name).read(), time.time())
    except NoService as error:
        if not (left := runs.left(name)):
            raise runs.refusal(name, error) from None
        found, code = left.why(time.time()), error.exit_code
    if as_json:
        print(json.dumps(found.as_dict(), indent=2))
    else:
        rows = [[(f"{label:<{LABEL}}", style.DIM), *summary.commands(text)] for label, text in found.rows()]
        style.show(summary.wrapped(rows, min(style.width(), MOST_COLUMNS), LABEL))
    return code


def _watch(name: str) -> int:
    """Until q; the exit code is 0 then, else 128 and the signal's number."""
    from failstop.cli.screen.live import Live
    from failstop.cli.screen.terminal import Terminal

    follower, live = runs.Follower(name), Live(name, fancy=style.fancy())
    with Terminal() as terminal:
        for typed, now_s in terminal.turns(PERIOD_S):
            if b"q" in typed.lower():
                return 0
            if terminal.stopped:
                terminal.suspend()
            elif now_s is not None:
                state, unix_s = follower.read(now_s), time.time()
                if state is None:
                    terminal.draw(live.gone(follower.note, unix_s, terminal.columns))
                else:
                    size = terminal.columns, terminal.rows
                    terminal.draw(live.lines(state, now_s, unix_s, *size, follower.events))
    return 128 + terminal.ended

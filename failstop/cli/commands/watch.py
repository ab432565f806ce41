"""`failstop status --watch`: the state live, until q or Ctrl-C; `failstop watch` is a second name of it."""

from __future__ import annotations

import time

from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen.follow import Follower
from failstop.cli.screen.live import Live
from failstop.cli.screen.terminal import Terminal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop watch                        # q or Ctrl-C ends it
ssh -t robot failstop watch           # from elsewhere
"""

PERIOD_S = 0.1


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop watch`."""
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Watch; the exit code is 0 after q, else 128 and the signal's number."""
    follower = Follower(arguments.name)
    live = Live(arguments.name, fancy=style.fancy())
    with Terminal() as terminal:
        next_s = time.monotonic()
        while not terminal.ended:
            if b"q" in terminal.wait(next_s - time.monotonic()).lower():
                return 0
            if terminal.stopped:
                terminal.suspend()
            now_s = time.monotonic()
            if now_s < next_s:
                continue
            next_s = max(next_s + PERIOD_S, now_s + PERIOD_S / 2)
            _draw(terminal, follower, live, now_s)
    return 128 + terminal.ended


def _draw(terminal: Terminal, follower: Follower, live: Live, now_s: float) -> None:
    state = follower.read(now_s)
    if state is None:
        terminal.draw(live.gone(follower.note, time.time(), terminal.columns))
    else:
        terminal.draw(live.lines(state, now_s, time.time(), terminal.columns, terminal.rows, follower.events))

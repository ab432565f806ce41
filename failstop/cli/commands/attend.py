"""`failstop attend`: proves to the service that an operator sits at a terminal. Some robots are allowed to move only
while an operator is present."""

from __future__ import annotations

import os
import re
import time
from argparse import ArgumentParser, Namespace
from collections import deque
from collections.abc import Mapping
from contextlib import suppress

import psutil

from failstop.api import verdict
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot, operator
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.cli.screen.terminal import IN, OUT, Terminal
from failstop.cli.style import DIM, FAIL, STRONG, WARN, Line

EXAMPLES = """\
failstop attend                       # q leaves, space stops
ssh -t robot failstop attend          # from another computer
failstop attend --as Anna
"""

PERIOD_S = 0.1
BETWEEN = {
    "tmux: server": "tmux",
    "tmux": "tmux",
    "screen": "screen",
    "SCREEN": "screen",
    "mosh-server": "mosh",
    "zellij": "zellij",
    "wezterm-mux-server": "wezterm's multiplexer",
}
"""Programs that may run between this process and the operator's terminal. They answer in place of the terminal, even
after the operator has closed it, so an absent operator would count as present. Each key is a process name, and its
value is the name that people know the program by."""
VARIABLES = {"TMUX": "tmux", "STY": "screen", "ZELLIJ": "zellij"}
"""The environment variables that such programs set, with their names."""
TERMS = ("tmux", "screen")
"""How TERM begins in tmux and in screen. ssh passes only TERM on, so it shows one that runs on the operator's own
computer."""
PLACES = 60
"""How many columns of the terminal are used, if it is wide enough. Every 0.1 s, the cursor moves to the next of these
columns, and the terminal is asked where the cursor is. So each column is used again after 6 s."""
ANSWER = re.compile(rb"\x1b\[(\d{1,4});(\d{1,4})R")
PART = re.compile(rb"\x1b(\[[\d;]{0,30})?\Z")
"""Matches an incomplete answer at the end of the bytes."""


class Questions:
    """Asks a terminal again and again where its cursor is. The answers prove that the terminal is still connected, for
    example through ssh. Pure, because the times are arguments.

    Each question first moves the cursor to another column, and the answer reports this column. A terminal answers in
    the order of the questions. So an answer belongs to the oldest unanswered question with the same column. A late
    answer proves only that the terminal was connected when the question was asked.
    """

    def __init__(self) -> None:
        self._open: deque[tuple[int, int]] = deque()
        self._number = 0
        self._rest = b""
        self.proven_ns = 0
        """When the newest answered question was asked (CLOCK_MONOTONIC, ns). 0 before the first answer."""

    def ask(self, now_ns: int, row: int, columns: int) -> str:
        """Make the next question, as text to write to the terminal. `columns`: the terminal's width. On a narrow
        terminal, fewer columns are used, because the cursor can't go beyond the last one."""
        column = 2 + self._number % max(1, min(PLACES, columns - 2))
        self._number += 1
        self._open.append((column, now_ns))
        return f"\x1b[{row};{column}H\x1b[6n"

    def typed(self, data: bytes) -> bytes:
        """Handle the terminal's answers in these bytes, and return the bytes that a person has typed."""
        data = self._rest + data
        for found in ANSWER.finditer(data):
            self._answered(int(found[2]))
        rest = ANSWER.sub(b"", data)
        part = PART.search(rest)
        self._rest = part[0] if part else b""
        return rest[: len(rest) - len(self._rest)]

    def _answered(self, column: int) -> None:
        if any(asked == column for asked, _ in self._open):
            asked = 0
            while asked != column:
                asked, self.proven_ns = self._open.popleft()  # answers come in order


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop attend`."""
    parser.add_argument("--as", dest="who", default="", metavar="NAME", help="the operator's name (default: this user)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command until the operator types q, a signal arrives, or the connection to the terminal ends. Raises
    FailstopError."""
    if other := _between() or _by_environment(os.environ):
        raise FailstopError(
            f"{other} would keep answering for your terminal after you have left, so run this outside of {other}"
        )
    if not os.isatty(IN):
        raise FailstopError("standard input must be the operator's terminal, because it proves that somebody is there")
    questions = Questions()
    user = arguments.who or os.environ.get("SUDO_USER") or os.environ.get("USER") or os.getuid()
    who = operator(f"{user} (terminal)")
    with Robot(arguments.name, client="failstop attend") as robot, Terminal() as terminal:
        for typed, now_s in terminal.turns(PERIOD_S):
            keys = questions.typed(typed).lower()
            if questions.proven_ns:
                robot.attend(who, questions.proven_ns)
            if b" " in keys:
                robot.estop("space")
            if b"q" in keys:
                return 0
            if now_s is not None:
                terminal.draw(_lines(robot, who, _answered(questions.proven_ns, now_s), terminal.columns))
                if terminal.writable():
                    terminal.write(questions.ask(time.monotonic_ns(), terminal.rows, _width()))
    return 128 + terminal.ended


def _between() -> str:
    """Return the name of a program around this process, such as tmux, that would answer in place of the terminal. Empty
    if there is none."""
    process: psutil.Process | None = psutil.Process()
    with suppress(psutil.Error):
        while process := process.parent() if process else None:
            if found := BETWEEN.get(process.name()):
                return found
    return ""


def _by_environment(environ: Mapping[str, str]) -> str:
    """Return the name of such a program if the environment shows that one is there. Empty if it shows none."""
    if found := [name for variable, name in VARIABLES.items() if environ.get(variable)]:
        return found[0]
    return next((name for name in TERMS if environ.get("TERM", "").startswith(name)), "")


def _width() -> int:
    """Return the terminal's real width in columns, which may have changed since the last call. If the terminal does not
    know it, return one that every terminal has."""
    with suppress(OSError):
        return os.get_terminal_size(OUT).columns or style.LEAST_COLUMNS
    return style.LEAST_COLUMNS


def _answered(proven_ns: int, now_s: float) -> str:
    """Return how this terminal has answered, in words. `proven_ns`: when the newest answered question was asked. It is
    0 if there was no answer yet. `now_s`: time.monotonic()."""
    if not proven_ns:
        return "this terminal has not answered yet where its cursor is, so use one that does"
    return f"the newest answer of this terminal is {max(0.0, now_s - proven_ns / 1e9):.1f} s old"


def _lines(robot: Robot, who: str, answered: str, columns: int) -> list[Line]:
    keys = ("   space stops, q leaves", DIM)
    try:
        state = robot.state
    except FailstopError as error:
        failed = style.wrap([(f"{verdict.without_state(error)}  ", FAIL), (str(error), STRONG)], columns, 0)
        return [[(f"{who} does not attend", FAIL), keys], [], *failed]
    rows = summary.wrapped(summary.wheels(state), columns)
    if state.attended_by is None:
        free = 'this robot needs nobody to attend, because attend.required is "off"'
        return [[(who, STRONG), keys], [], *rows, [], [(free, WARN)]]
    if who in state.attended_by:
        return [[(f"{who} attends", STRONG), keys], [], *rows]
    head = [[(f"{who} does not attend", FAIL), keys], *style.wrap([(answered, WARN)], columns, 0)]
    return [*head, [], *rows]

"""`failstop attend`: an operator at a terminal, for a robot that moves only while one is there."""

from __future__ import annotations

import os
import select
import time

from failstop.api import verdict
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.cli.screen.follow import Follower
from failstop.cli.screen.questions import Questions
from failstop.cli.screen.terminal import OUT, Terminal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from failstop.api.calls import Attendance
    from failstop.api.state import State
    from failstop.cli.style import Line

EXAMPLES = """\
failstop attend                       # q leaves, space stops
ssh -t robot failstop attend          # from elsewhere
failstop attend --as Anna
"""

PERIOD_S = 0.1
BETWEEN = {"tmux: server": "tmux", "tmux": "tmux", "screen": "screen", "SCREEN": "screen", "mosh-server": "mosh"}
"""Processes that answer in a terminal's place, whether or not anybody is at it."""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop attend`."""
    parser.add_argument("--as", dest="who", default="", metavar="NAME", help="who attends (default: this user)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Attend until q, a signal, or the line's end. Raises FailstopError."""
    if other := _between(os.getpid()):
        raise FailstopError(
            f"{other} answers in your terminal's place, and would go on when you are gone: run this outside of it"
        )
    follower = Follower(arguments.name)
    who = f"{arguments.who or _user()} (terminal)"
    with Robot(arguments.name, client="failstop attend") as robot, robot.attend(who) as attendance:
        return _attend(robot, attendance, follower)


def _attend(robot: Robot, attendance: Attendance, follower: Follower) -> int:
    questions = Questions()
    with Terminal() as terminal:
        next_s = time.monotonic()
        while not terminal.ended:
            typed = questions.typed(terminal.wait(next_s - time.monotonic())).lower()
            if questions.proven_ns:
                attendance.renew(questions.proven_ns)
            if b" " in typed:
                robot.estop("space")
            if b"q" in typed:
                return 0
            if terminal.stopped:
                attendance.give_up()
                terminal.suspend()
            now_s = time.monotonic()
            if now_s < next_s:
                continue
            next_s = max(next_s + PERIOD_S, now_s + PERIOD_S / 2)
            terminal.draw(_lines(follower.read(now_s), follower.note, attendance.who, terminal.columns))
            if select.select((), (OUT,), (), 0)[1]:
                terminal.write(questions.ask(time.monotonic_ns(), terminal.rows))
    return 128 + terminal.ended


def _lines(state: State | None, note: str, who: str, columns: int) -> list[Line]:
    head: list[Line] = [[(f"{who} attends", style.STRONG), ("   space stops, q leaves", style.DIM)], []]
    if state is None:
        return [*head, [("NO SERVICE  ", style.FAIL), (note, style.STRONG)]]
    rows = [part for row in summary.wheels(state) for part in style.wrap(row, columns, summary.LABEL)]
    if state.attended_by is None:
        rows.append([("", style.PLAIN)])
        rows.append([('nobody needs to attend this robot: attend.required is "off"', style.WARN)])
    elif doubt := verdict.doubt(state):
        rows.append([(doubt, style.FAIL)])
    return [*head, *rows]


def _user() -> str:
    """Whose name the terminal's user goes by."""
    return os.environ.get("SUDO_USER") or os.environ.get("USER") or str(os.getuid())


def _between(pid: int) -> str:
    """The program that answers in the terminal's place, if there is one above this process."""
    while pid > 1:
        try:
            with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
                text = file.read()
        except OSError:
            return ""
        name = text[text.index("(") + 1 : text.rindex(")")]
        if name in BETWEEN:
            return BETWEEN[name]
        pid = int(text[text.rindex(")") + 2 :].split()[1])
    return ""

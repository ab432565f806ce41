"""`failstop attend` in a terminal that answers as long as its operator is there."""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path

import pytest

from failstop.cli.commands.attend import BETWEEN
from failstop_lab.trial import Trial, wait_for
from tests.support.commands import FAILSTOP
from tests.support.typist import Typist

LEASE_S = 1.0
SETTINGS = f'[attend]\nrequired = "on"\nlease_s = {LEASE_S}\n'


class Answering:
    """A context manager: reads what a command writes, and answers where the cursor is, as every terminal does: the
    cursor stops at the last column."""

    def __init__(self, typist: Typist, columns: int = 80) -> None:
        self._typist = typist
        self._columns = columns
        self.seen = b""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Answering:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(0.01):
            try:
                written = os.read(self._typist.master, 65536)
            except (BlockingIOError, OSError):
                continue
            self.seen += written
            for row, column in re.findall(rb"\x1b\[(\d+);(\d+)H\x1b\[6n", written):
                os.write(self._typist.master, b"\x1b[%s;%dR" % (row, min(int(column), self._columns)))


def test_it_attends_while_the_terminal_answers(trial: Trial) -> None:
    with Typist.failstop("attend", "--name", trial.name, "--as", "Anna") as typist:
        with Answering(typist):
            wait_for("Anna", lambda: trial.robot.state.attended_by == ("Anna (terminal)",))
            trial.enable()
            trial.drive(LEASE_S * 1.5)
            assert trial.turning()
        gone = "operator gone: Anna (terminal), was not heard"
        wait_for("the stop", lambda: trial.drive(0.1) or gone in str(trial.robot.state.estop))
        trial.board.wait_wheels(turning=False, timeout_s=10.0)


def test_it_does_not_say_that_somebody_attends_whom_the_robot_does_not_count(trial: Trial) -> None:
    """The terminal does not answer yet, then it does, then it does not any more."""
    name = "Anna " * 30  # longer than the robot keeps it
    with Typist.failstop("attend", "--name", trial.name, "--as", name) as typist:
        shown = typist.wait("does not attend")
        assert "this terminal has not answered yet" in " ".join(shown.split())
        with Answering(typist) as terminal:
            wait_for("Anna", lambda: b" attends" in terminal.seen)
            assert trial.robot.state.attended_by
        typist.wait(" s old")
        assert trial.robot.state.attended_by == ()


def test_without_a_terminal_at_its_input_it_is_refused(trial: Trial) -> None:
    command = f"{' '.join(FAILSTOP)} attend --name {trial.name} < /dev/null; exit $?"
    with Typist(["/bin/sh", "-c", command]) as typist:
        assert typist.end() == 1
        assert "standard input must be" in " ".join(typist.screen().split())


def test_it_attends_on_the_narrowest_terminal(trial: Trial) -> None:
    columns = 12
    with Typist.failstop("attend", "--name", trial.name, columns=columns) as typist, Answering(typist, columns):
        wait_for("somebody", lambda: trial.robot.state.attended_by)
        trial.enable()
        trial.drive(LEASE_S * 2.5)
        assert trial.turning()


def test_q_leaves_at_once(trial: Trial) -> None:
    with Typist.failstop("attend", "--name", trial.name) as typist:
        with Answering(typist):
            wait_for("somebody", lambda: trial.robot.state.attended_by)
            trial.enable()
            os.write(typist.master, b"q")
            wait_for("the stop", lambda: trial.robot.state.estop)
        assert ", left" in str(trial.robot.state.estop)
        assert typist.process.wait(10) == 0


REFUSES = "would keep answering for your terminal"


@pytest.mark.parametrize("name", ["tmux", "screen", "mosh-server", "zellij", "wezterm-mux-server"])
def test_what_answers_in_its_place_is_refused(trial: Trial, name: str, tmp_path: Path) -> None:
    """A program of that name above it; a real tmux's server calls itself `tmux: server`."""
    shell = tmp_path / name
    shell.symlink_to("/bin/sh")
    with Typist([str(shell), "-c", f"{' '.join(FAILSTOP)} attend --name {trial.name}; exit $?"]) as typist:
        assert typist.process.wait(20) == 1
        written = os.read(typist.master, 4096).decode()
    assert f"{BETWEEN[name]} {REFUSES}" in " ".join(written.split())


@pytest.mark.parametrize(
    ("environ", "name"),
    [
        ({"TERM": "tmux-256color"}, "tmux"),
        ({"TERM": "screen.xterm-256color"}, "screen"),
        ({"TMUX": "/tmp/tmux-1000/default,4711,0"}, "tmux"),
        ({"STY": "4711.pts-0.desk"}, "screen"),
        ({"ZELLIJ": "0"}, "zellij"),
    ],
)
def test_what_answers_in_its_place_on_the_operator_s_own_computer_is_refused(
    trial: Trial, environ: dict[str, str], name: str
) -> None:
    """ssh passes TERM on."""
    with Typist([*FAILSTOP, "attend", "--name", trial.name], environ=environ) as typist:
        assert typist.process.wait(20) == 1
        written = os.read(typist.master, 4096).decode()
    assert f"{name} {REFUSES}" in " ".join(written.split())

"""What a probe says of the wheels at its end, with its watcher hanging and with the plug out. The simulated board is
the judge: it is one that keeps its last speed forever, and that confirms a stop."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from failstop.policy.halted import CONFIRMED, MAY_TURN
from failstop_lab.probe.watcher import WATCHER_HANGS
from failstop_lab.sim.client import SimBoard
from tests.support.commands import FAILSTOP
from tests.support.terminal import Terminal

MOVES_S, STOPS_S, ENDS_S = 40.0, 40.0, 60.0
CTRL_C = b"\x03"
UNPLUGGED = f"is unplugged: {MAY_TURN}"

pytestmark = pytest.mark.slow


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SimBoard]:
    with SimBoard(tmp_path / "b") as running:
        yield running


def probing(board: SimBoard, tmp_path: Path, *more: str) -> Terminal:
    words = ["probe", "serial", "--board", "rrc", "--port", board.link, "--yes", "--rows", "silence", *more]
    return Terminal(*FAILSTOP, *words, "--out", str(tmp_path / "card"), patience_s=ENDS_S)


def ended(tmp_path: Path) -> str:
    """Why it ended early, as its card says."""
    return str(json.loads((tmp_path / "card.json").read_text())["ended"])


def watcher_of(process: subprocess.Popen[bytes]) -> psutil.Process:
    found = psutil.Process(process.pid).children(recursive=True)
    return next(each for each in found if any("watcher" in word for word in each.cmdline()))


def test_a_watcher_that_hangs_is_killed_and_the_probe_stops_the_wheels(board: SimBoard, tmp_path: Path) -> None:
    """Ctrl-C, and nobody answers: the wheels turn until the probe itself has written the stop."""
    with probing(board, tmp_path) as person:
        board.wait_wheels(True, MOVES_S)
        watcher = watcher_of(person.process)
        os.kill(watcher.pid, signal.SIGSTOP)
        person.presses(CTRL_C)
        assert person.ends() == 130
        assert not any(board.wheels())
        assert not watcher.is_running()
    assert ended(tmp_path) == f"interrupted; {CONFIRMED}"


def test_a_watcher_that_hangs_ends_the_probe_which_stops_the_wheels(board: SimBoard, tmp_path: Path) -> None:
    with probing(board, tmp_path) as person:
        board.wait_wheels(True, MOVES_S)
        watcher = watcher_of(person.process)
        os.kill(watcher.pid, signal.SIGSTOP)
        assert person.ends() == 1
        assert not any(board.wheels())
        assert not watcher.is_running()
    assert ended(tmp_path) == f"{WATCHER_HANGS}; {CONFIRMED}"


def test_an_unplugged_board_is_waited_for_and_stopped(board: SimBoard, tmp_path: Path) -> None:
    with probing(board, tmp_path) as person:
        board.wait_wheels(True, MOVES_S)
        board.unplug()
        person.presses(CTRL_C)
        person.reads(UNPLUGGED)
        assert any(board.wheels())
        board.replug()
        assert person.ends() == 130
        assert not any(board.wheels())
    assert ended(tmp_path) == f"interrupted; {CONFIRMED}"


def test_a_second_ctrl_c_ends_the_waiting_with_the_truth(board: SimBoard, tmp_path: Path) -> None:
    """The watcher goes on waiting by itself."""
    with probing(board, tmp_path) as person:
        board.wait_wheels(True, MOVES_S)
        watcher = watcher_of(person.process)
        board.unplug()
        person.presses(CTRL_C)
        person.reads(UNPLUGGED)
        person.presses(CTRL_C)
        assert person.ends() == 1
        assert any(board.wheels())
    assert ended(tmp_path) == f"interrupted; {board.link} {UNPLUGGED}"
    board.replug()
    board.wait_wheels(False, STOPS_S)
    board.unplug()
    assert not psutil.wait_procs([watcher], ENDS_S)[1], "its repeats wait for no port that has gone again"


@pytest.mark.parametrize("deaf", [False, True])
def test_a_probe_of_the_guard_port_that_is_interrupted_says_what_the_board_confirms(
    deaf: bool, board: SimBoard, tmp_path: Path
) -> None:
    """Its service ends cleanly, and only the board's answer says whether that stop has arrived."""
    with probing(board, tmp_path, "--guard") as person:
        person.reads("now the same through the guard port")
        board.wait_wheels(False, STOPS_S)
        board.wait_wheels(True, MOVES_S)
        board.deaf(deaf)
        person.presses(CTRL_C)
        assert person.ends() == (1 if deaf else 130)
        assert any(board.wheels()) is deaf
    told = f"a stop was written to {board.link}, but the board did not confirm it: {MAY_TURN}" if deaf else CONFIRMED
    assert ended(tmp_path) == f"interrupted; {told}"


def test_a_plug_that_is_pulled_in_the_middle_of_a_row_is_no_answer_of_the_board(
    board: SimBoard, tmp_path: Path
) -> None:
    """Nobody saw the wheels: that they never stopped would be as wrong as that they did."""
    with probing(board, tmp_path) as person:
        person.reads("its driver falls silent ...")
        board.wait_wheels(True, MOVES_S)
        board.unplug()
        board.replug()
        assert person.ends() == 1
        board.wait_wheels(False, STOPS_S)
    card = json.loads((tmp_path / "card.json").read_text())
    assert not card["rows"]
    assert "disappeared during the test" in card["ended"]

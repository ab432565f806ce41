"""The page on destructors: each of its programs is ended in each of the ways of its table, and the board says whether
the wheels turn on as the table says."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.support.pages import ROOT, blocks

PAGE = ROOT / "docs/why-your-destructor-does-not-stop-the-robot.md"
PORT = "/tmp/board"
ENDS: tuple[signal.Signals | None, ...] = (None, signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGSTOP)
"""The table's columns; None: the program ends by itself."""
ROW = re.compile(r"^\| \[[^\]]+\]\([^)]*\) \|(.*)\|$", re.MULTILINE)
MOVES_S, STANDS_S = 20.0, 20.0


def table() -> list[list[bool]]:
    """Of each program, in the page's order, whether the wheels stop, by the way in which it ends."""
    return [["drives on" not in cell for cell in row.split("|")] for row in ROW.findall(PAGE.read_text())]


PROGRAMS = [block.text for block in blocks(PAGE) if block.language == "python"]


def hung(pid: int) -> None:
    """Wait until a process stands still."""
    process = psutil.Process(pid)
    wait_for("it to hang", lambda: process.status() == psutil.STATUS_STOPPED)


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    with SimBoard(tmp_path_factory.mktemp("b") / "board", board="ugv") as made:
        yield made


def test_the_table_has_a_row_for_each_program() -> None:
    assert len(table()) == len(PROGRAMS) == 5
    assert {len(row) for row in table()} == {len(ENDS)}


@pytest.mark.slow
@pytest.mark.parametrize("number", range(5))
def test_a_program_stops_the_wheels_where_the_table_says_so(number: int, board: SimBoard, tmp_path: Path) -> None:
    assert PORT in PROGRAMS[number]
    for end, stops in zip(ENDS, table()[number], strict=True):
        text = PROGRAMS[number].replace(PORT, board.link)
        script = tmp_path / "program.py"
        script.write_text(text if end else text.replace("range(30)", "range(3)"))
        with open(board.link, "wb", buffering=0) as port:
            port.write(b'\n{"T":1,"L":0,"R":0}\n')
        board.wait_wheels(False, STANDS_S)
        board.events()
        program = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
        try:
            board.wait_for(lambda event: event.is_motion, MOVES_S)
            if end:
                program.send_signal(end)
            if end == signal.SIGSTOP:
                hung(program.pid)
            else:
                program.wait(MOVES_S)
            if stops:  # by a frame of its own, which the board may still have to read, and not by the board's watchdog
                board.wait_for(lambda event: not event.is_motion, STANDS_S)
            board.events()
            assert any(board.wheels()) is not stops, f"ended by {end}"
        finally:
            program.kill()
            program.wait()

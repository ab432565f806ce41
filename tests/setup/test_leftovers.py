"""Leftovers: a service of one use that is killed with its program leaves nothing after the next such program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pytest

from failstop.board.kinds import board_of
from failstop.files import instance
from failstop.messages import segments
from failstop.setup import leftovers
from failstop.setup.halt import Halt
from failstop.setup.rig import RIG, Rig
from failstop_lab.sim.client import SimBoard

VALUES: dict[str, object] = {"board.kind": "ugv"}
ENDS_S = 10.0
HOLDS = """
import sys, time
from failstop.board.kinds import board_of
from failstop.setup.halt import Halt
from failstop.setup.rig import Rig
board = board_of("ugv", 0.08, 0.0)
with Rig(sys.argv[1], {"board.kind": "ugv"}, Halt(sys.argv[1], board, print)) as rig:
    print(rig.name, flush=True)
    time.sleep(600)
"""


def left(name: str) -> list[str]:
    """Everything of this name: shared memory, runtime folders, folders for files."""
    memory = [file for file in os.listdir(segments.SHM) if file.startswith(f"failstop.{name}.")]
    runtime = [path for path in instance.places(name) if os.path.exists(path)]
    return [*memory, *runtime, *(str(path) for path in Path(tempfile.gettempdir()).glob(f"failstop-{name}.*"))]


def test_the_next_setup_removes_what_a_killed_one_and_its_service_left(tmp_path: Path) -> None:
    with SimBoard(tmp_path / "b", board="ugv") as board:
        killed = subprocess.Popen([sys.executable, "-c", HOLDS, board.link], stdout=subprocess.PIPE, text=True)
        assert killed.stdout
        name = killed.stdout.readline().strip()
        assert name == f"{RIG}{killed.pid}"
        each = psutil.Process(killed.pid).children(recursive=True)
        for process in (killed.pid, *(one.pid for one in each)):
            os.kill(process, signal.SIGKILL)
        killed.wait()
        killed.stdout.close()
        assert not psutil.wait_procs(each, ENDS_S)[1]
        assert len(left(name)) == 16, "14 segments, a runtime folder, a folder"
        living = f"{RIG}{os.getpid()}"
        with Rig(board.link, VALUES, Halt(board.link, board_of("ugv", 0.08, 0.0), pytest.fail)):
            assert left(name) == []
            leftovers.remove_ended(RIG)
            assert len(left(living)) == 16
        assert left(living) == []

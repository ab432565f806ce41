"""The program that `make fresh` runs in a fresh Debian, on this machine: `make test` has no fresh systems."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.files import root
from failstop_lab.sim.client import SimBoard
from tests.packaging.fresh import EMULATED_KIND, EMULATED_OWN, OWN, TRIALS, unstopped
from tests.support.commands import script
from tests.support.pages import ROOT

LIMIT_S = 60


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A root of its own for the service, and the commands of this checkout."""
    place = Path(os.environ[root.VARIABLE]) / tmp_path.name
    (place / "run").mkdir(parents=True)
    monkeypatch.setenv(root.VARIABLE, str(place))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")


def run(program: str, folder: Path, *words: object) -> str:
    """What the program prints, which must end as it should."""
    path = folder / "own.py"
    path.write_text(program)
    done = subprocess.run(
        [sys.executable, path, *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=4 * LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("place")
def test_a_program_of_the_user_s_own_is_killed_and_the_service_names_it(tmp_path: Path) -> None:
    said = run(OWN, tmp_path, tmp_path / "board", LIMIT_S)
    assert "own program: killed while it drove, the wheels stood after " in said


@pytest.mark.slow
@pytest.mark.usefixtures("place")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root takes a capability away")
def test_the_emulated_program_is_judged_by_the_board_outside(tmp_path: Path) -> None:
    with SimBoard(tmp_path / "board", board=EMULATED_KIND) as board:
        run(EMULATED_OWN, tmp_path, EMULATED_KIND, tmp_path, LIMIT_S)
        events = board.events()
    killed_ns = int((tmp_path / "killed").read_text())
    assert unstopped(events, killed_ns) == ""
    assert unstopped(events, events[0].arrival_ns) == "the wheels were not turning"
    driving = [event for event in events if event.arrival_ns < killed_ns]
    assert unstopped(driving, killed_ns).startswith("no stop, or motion after it: ")


def test_each_system_that_is_tried_becomes_a_record() -> None:
    tried = script(ROOT / "packaging/tried.py")
    lines = "".join(f"{trial.name()}: good, 80 s\n" for trial in TRIALS.values())
    assert list(tried.results(tried.ROWS["fresh"], lines, 0, "")) == [trial.name() for trial in TRIALS.values()]

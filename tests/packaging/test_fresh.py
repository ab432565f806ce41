"""The program that `make fresh` runs in a fresh Debian, on this machine: `make test` has no fresh systems."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.files import root
from tests.packaging.fresh import OWN, TRIALS
from tests.support.commands import script
from tests.support.pages import ROOT

LIMIT_S = 60


@pytest.mark.slow
def test_a_program_of_the_user_s_own_is_killed_and_the_service_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Path(os.environ[root.VARIABLE]) / "fresh"
    (place / "run").mkdir(parents=True)
    monkeypatch.setenv(root.VARIABLE, str(place))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    program = tmp_path / "own.py"
    program.write_text(OWN)
    done = subprocess.run(
        [sys.executable, program, tmp_path / "board", str(LIMIT_S)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=4 * LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "own program: killed while it drove, the wheels stood after " in done.stdout


def test_each_system_that_is_tried_becomes_a_record() -> None:
    tried = script(ROOT / "packaging/tried.py")
    lines = "".join(f"{trial.name()}: good, 80 s\n" for trial in TRIALS.values())
    assert list(tried.results(tried.ROWS["fresh"], lines, 0, "")) == [trial.name() for trial in TRIALS.values()]

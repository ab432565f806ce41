"""A test that passes on its second try is a finding: it is named at the end, and in a file."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import findings

TESTS = """
from pathlib import Path

TRIED = Path(__file__).with_name("tried")


def test_right(): ...


def test_wrong():
    assert False


def test_late():
    first = not TRIED.exists()
    TRIED.touch()
    assert not first
"""


@pytest.mark.starts
def test_what_passes_on_its_second_try_is_found_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    last, noted, file = tmp_path / ".pytest_cache/v/cache/lastfailed", tmp_path / "noted", tmp_path / "build/found.txt"
    pytest_ = (sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "--rootdir", str(tmp_path), "test_it.py")
    findings.start(noted, file)
    assert subprocess.run(pytest_, cwd=tmp_path, capture_output=True, check=False).returncode == 1
    findings.note(last, noted)
    again = (*pytest_, "--last-failed", "--last-failed-no-failures", "none")
    assert subprocess.run(again, cwd=tmp_path, capture_output=True, check=False).returncode == 1
    assert findings.passed_then(last, noted, file) == ["test_it.py::test_late"]
    assert file.read_text() == "test_it.py::test_late\n"


def test_two_parts_of_a_run_add_up_and_the_next_run_forgets(tmp_path: Path) -> None:
    last, noted, file = tmp_path / "last", tmp_path / "noted", tmp_path / "found.txt"
    for name in ("one", "two"):
        last.write_text(json.dumps({name: True}))
        findings.note(last, noted)
        last.write_text("{}")
    assert findings.passed_then(last, noted, file) == ["one", "two"]
    findings.start(noted, file)
    assert findings.passed_then(last, noted, file) == []
    assert file.read_text() == ""

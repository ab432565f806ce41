"""The model of the stop protocol: every verdict as expected; and that the check itself can fail."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from failstop_lab.case.cited import script
from tests.support.amounts import LONG

CHECK = Path(__file__).resolve().parent.parent.parent / "model" / "check"
PAGE = CHECK.with_name("README.md")
SLOW_S = 600


check = script(CHECK)


def skip_reason(missing: list[str], environment: dict[str, str]) -> str:
    """Why the model cannot be checked here; empty when it can. In CI a missing program is a failure, not a reason."""
    if not missing:
        return ""
    reason = f"the model needs {' and '.join(missing)}: apt-get install {' '.join(missing)}"
    if environment.get("CI") == "true":
        pytest.fail(f"CI must check the model; {reason}")
    return reason


@pytest.fixture
def tools() -> None:
    if reason := skip_reason(check.missing_tools(), dict(os.environ)):
        pytest.skip(reason)


def test_a_missing_program_is_skipped_at_home_with_its_name_and_fails_in_ci() -> None:
    assert "spin" in skip_reason(["spin"], {})
    assert skip_reason([], {"CI": "true"}) == ""
    with pytest.raises(pytest.fail.Exception, match="CI must check the model"):
        skip_reason(["spin"], {"CI": "true"})


@pytest.mark.parametrize(
    ("output", "found"),
    [
        ("State-vector 92 byte, depth reached 9, errors: 0", check.HOLDS),
        ("max search depth too small\ndepth reached 9, errors: 0", "search cut short: max search depth too small"),
        ("pan: reached -DMEMLIM bound\ndepth reached 9, errors: 0", "search cut short: reached -DMEMLIM"),
        ("Warning: Search not completed\ndepth reached 9, errors: 0", "search not completed"),
        ("pan:1: assertion violated (frame_mark!=2) (at depth 70)\nerrors: 1", "S1"),
        ("pan:1: assertion violated  !(told) (at depth 5)\nerrors: 1", "S3"),
        ("pan:1: acceptance cycle (at depth 5)\nerrors: 1", "ends"),
        ("Killed", "no verdict"),
    ],
)
def test_only_a_whole_search_without_errors_holds(output: str, found: str) -> None:
    assert check.verdict(output) == found


def test_a_search_that_is_too_shallow_or_takes_too_long_proves_nothing(tools: None) -> None:
    assert check.run(("FAULTS=1",), depth=50).verdict == "search cut short: max search depth too small"
    assert check.run(("FAULTS=1",), limit_s=0.01).verdict.startswith("not done in")
    assert check.run(("FAULTS=1", "NO_STOPPED_IN")).verdict == "S1", "a port owner that forgets its stops"


@pytest.mark.slow
@pytest.mark.timeout(SLOW_S + 30)
def test_every_verdict_is_the_expected_one(tools: None) -> None:
    """Each day another part of the quick rows, and all of them in a campaign: of this very model CHECKED has them."""
    part = [] if LONG else ["--part", str(int(time.time()) // 86_400)]
    command = [sys.executable, str(CHECK), "--quick", *part]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SLOW_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    quick = len(check.RUNS) - len(check.LONG)
    assert len(done.stdout.splitlines()) - 2 in (
        {quick} if part == [] else {quick // check.DAYS, quick // check.DAYS + 1}
    )


def test_the_model_that_was_checked_whole_is_this_one() -> None:
    """Two faults take minutes: `make model` has them searched, and leaves what it found."""
    first, *lines = check.CHECKED.read_text().splitlines()
    assert first.split()[0] == check.digest(), "the model was changed: run `make model`"
    found = [re.split(r" {2,}", line) for line in lines]
    assert [(name, verdict) for name, _, verdict in found] == [(name, verdict) for name, _, verdict in check.RUNS]
    held = [int(states) for _, states, verdict in found if verdict == check.HOLDS]
    assert all(f" {states:,} |" in PAGE.read_text() for states in held), "the page has other numbers"


def test_another_model_has_another_digest(tmp_path: Path) -> None:
    before = check.digest()
    assert check.digest(runs=check.RUNS[1:]) != before
    changed = tmp_path / "stop.pml"
    changed.write_bytes(check.MODEL.read_bytes().replace(b"byte epoch = 1;", b"byte epoch = 2;"))
    assert check.digest(changed) != before

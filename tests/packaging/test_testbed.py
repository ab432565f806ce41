"""Debian's judges: none of autopkgtest's tests is skipped for what the container is said to lack, and a warning of
piuparts is no failure."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.packaging import debian_tests

pytestmark = pytest.mark.starts
ROOT_NEEDED = {"needs-root": "root-on-testbed"}
"""A restriction of a test that goes by another name as a capability."""


@pytest.fixture
def answers(tmp_path: Path) -> list[str]:
    """The lines that the server answers; its container is this machine."""
    if not Path("/usr/share/autopkgtest/lib/VirtSubproc.py").exists():
        pytest.skip("not installed: autopkgtest")
    words = [sys.executable, str(debian_tests.TESTBED), "/", "env", f"TMPDIR={tmp_path}"]
    asked = "open\ncapabilities\nprint-execute-command\nclose\ncapabilities\nquit\n"
    done = subprocess.run(words, input=asked, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_container_offers_what_each_test_asks_for(answers: list[str], tmp_path: Path) -> None:
    ready, opened, capabilities, command, _, closed = answers
    folder = opened.removeprefix("ok ")
    assert ready == "ok"
    assert folder.startswith(str(tmp_path))
    assert f"downtmp-host=/{folder}" in capabilities
    assert command == f"ok env,TMPDIR%3D{tmp_path}"
    assert "downtmp-host" not in closed
    assert not Path(folder).exists()
    asked = re.findall(r"^Restrictions: (.+)$", (debian_tests.TESTS / "control").read_text(), re.MULTILINE)
    wanted = {ROOT_NEEDED.get(word, word) for line in asked for word in line.split(", ")}
    assert {"isolation-container", "root-on-testbed"} == wanted
    assert wanted <= set(capabilities.split())


def test_a_warning_of_piuparts_is_not_said_to_be_wrong() -> None:
    text = "2m14.7s ERROR: WARN: Broken symlinks:\n2m17.8s ERROR: FAIL: Package purging left files on system:\n"
    assert debian_tests.complaints(text) == ["FAIL: Package purging left files on system:"]

"""Root: where the files of an instance are that outlive it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.files import root
from failstop.files.root import state_directory


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in place of /var/lib/failstop."""
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    (tmp_path / "var" / "lib").mkdir(parents=True)
    return tmp_path / "var" / "lib" / "failstop"


def test_the_state_directory_is_the_first_that_is_given(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/x")
    assert state_directory("robot", {}) == "/home/x/.local/state/failstop/robot"
    assert state_directory("robot", {"XDG_STATE_HOME": "/elsewhere"}) == "/elsewhere/failstop/robot"
    base.mkdir()
    for _ in range(2):
        assert state_directory("robot", {"XDG_STATE_HOME": "/home/x"}) == str(base / "robot")
        (base / "robot").mkdir(exist_ok=True)
    assert state_directory("robot", {"STATE_DIRECTORY": "/given:/other"}) == "/given"
    assert state_directory("robot", {"STATE_DIRECTORY": "/given"}, "/chosen") == "/chosen"


def test_a_file_in_the_place_of_the_state_directory_is_passed_over(base: Path) -> None:
    base.mkdir()
    (base / "robot").write_text("in the way")
    assert state_directory("robot", {"XDG_STATE_HOME": "/home/x"}) == "/home/x/failstop/robot"
    assert state_directory("left", {"XDG_STATE_HOME": "/home/x"}) == str(base / "left")


@pytest.mark.parametrize("made", [False, True])
def test_who_is_asked_of_another_user_s_directory_is_asked_of_the_nearest_that_is_there(base: Path, made: bool) -> None:
    (base / "robot" if made else base).mkdir(parents=True)
    asked = []
    for answer, found in ((True, f"{base}/robot"), (False, "/home/x/.local/state/failstop/robot")):

        def writable(path: str, answer: bool = answer) -> bool:
            asked.append(path)
            return answer

        assert state_directory("robot", {"HOME": "/home/x"}, writable=writable) == found
    assert asked == [f"{base}/robot" if made else str(base)] * 2


def test_a_directory_is_this_user_s_if_files_can_be_made_in_it(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(os, "access", lambda *about: asked.append(about))
    base.mkdir()
    assert state_directory("robot", {"XDG_STATE_HOME": "/home/x"}) == "/home/x/failstop/robot"
    assert asked == [(str(base), os.W_OK | os.X_OK)]

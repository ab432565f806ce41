"""The end of setup: the stand test, and its settings file."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import stat
import tempfile
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from failstop.files import durable
from failstop.policy.halted import CONFIRMED, MAY_TURN, Halted
from failstop.setup import command, finish
from failstop.setup.draft import Draft
from failstop.setup.talk import Left, Talk
from tests.support.children import needs_root
from tests.support.unprivileged import unprivileged


class Answers:
    """Somebody who names a file and replaces it."""

    def __init__(self, path: Path) -> None:
        self._answers = {"file": str(path), "replace": finish.REPLACE}

    def ask(self, key: str, *_: Any, **__: Any) -> str:
        return self._answers[key]

    def say(self, *_: Any) -> None:
        pass


@pytest.mark.parametrize("calls", [0, 1])
def test_whenever_it_ends_there_is_a_settings_file(calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "failstop.toml"
    path.write_text("board.kind = 'ugv'\n")
    left = calls

    def ends(act: Any) -> Any:
        def each(*words: Any) -> None:
            nonlocal left
            if not left:
                raise KeyboardInterrupt
            left -= 1
            act(*words)

        return each

    for name in ("write_draft", "publish"):
        monkeypatch.setattr(durable, name, ends(getattr(durable, name)))
    with pytest.raises(KeyboardInterrupt):
        finish.write(Answers(path), "board.kind = 'rrc'\n", "failstop")  # type: ignore[arg-type]
    assert path.read_text() == "board.kind = 'ugv'\n"
    monkeypatch.undo()
    finish.write(Answers(path), "board.kind = 'rrc'\n", "failstop")  # type: ignore[arg-type]
    assert path.read_text() == "board.kind = 'rrc'\n"
    assert (tmp_path / "failstop.toml.old").read_text() == "board.kind = 'ugv'\n"


def test_the_service_s_user_may_read_new_settings_whatever_the_umask(tmp_path: Path) -> None:
    mask = os.umask(0o077)
    try:
        finish.write(Answers(path := tmp_path / "failstop.toml"), "board.kind = 'rrc'\n", "failstop")  # type: ignore[arg-type]
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


REFUSED, NO_TEST = 2, 1


class Runs:
    """`failstop prove`, with these exit codes one after the other, and a result if the verdict has one."""

    def __init__(self, *runs: tuple[int, str]) -> None:
        self._left = list(runs)
        self.words: list[list[str]] = []
        self.said: list[str | None] = []

    def run(self, words: Sequence[str], said: str | None) -> tuple[int, bool]:
        self.words.append([*words])
        self.said.append(said)
        code, verdict = self._left.pop(0)
        if verdict:
            place = Path(words[words.index("--out") + 1]) / str(len(self.words))
            place.mkdir(parents=True)
            (place / finish.RESULT).write_text(json.dumps({"passed": verdict == "PASS", "verdict": verdict}))
        return code, False


class Board:
    """What stops the wheels, of a board that obeys or that has become deaf."""

    def __init__(self, *, hears: bool = True) -> None:
        self._found = Halted("/nowhere", written=True, confirms=True, confirmed=hears)
        self.stops = 0
        self.last: Halted | None = None

    def now(self, _waits_s: float) -> Halted:
        self.stops += 1
        self.last = self._found
        return self._found


def proved(
    place: Path,
    tests: Runs,
    monkeypatch: pytest.MonkeyPatch,
    typed: Sequence[str] | None = None,
    board: Board | None = None,
    **given: str,
) -> Mapping[str, Any]:
    """The evidence at the end of the sixth step, for a robot called `left`. `typed`: what somebody types at the
    terminal; None: nobody is there."""
    answers = iter(typed or ())
    monkeypatch.setenv("STATE_DIRECTORY", str(place))
    monkeypatch.setattr(finish, "_run", tests.run)
    monkeypatch.setattr(finish, "here", lambda _: True)
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: next(answers))
    talk = Talk(given, Draft("left", {"STATE_DIRECTORY": str(place)}), silent=typed is None)
    found = command._prove(talk, {"board.kind": "ugv"}, "/nowhere", "left", board or Board())  # type: ignore[arg-type]
    assert next(answers, None) is None, "it asked for all of it"
    return found


@pytest.mark.parametrize("yes", ["yes", "y", "Yes"])
def test_the_stand_test_is_of_the_robot_that_is_set_up(
    yes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tests = Runs((0, "PASS"))
    assert proved(tmp_path, tests, monkeypatch, prove=yes)["passed"]
    [words] = tests.words
    assert words[words.index("--name") + 1] == "left"
    assert tests.said == [finish.CONSENT]


@pytest.mark.parametrize("no", ["no", "n", "No"])
def test_a_stand_test_that_nobody_wants_is_skipped(no: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert proved(tmp_path, Runs(), monkeypatch, prove=no) == {}
    assert proved(tmp_path, Runs((REFUSED, "")), monkeypatch, typed=[]) == {}, "the person did not type the word"


def test_another_answer_than_yes_and_no_is_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Left, match="--prove later: type yes or no"):
        proved(tmp_path, Runs(), monkeypatch, prove="later")


@pytest.mark.parametrize("code", [NO_TEST, REFUSED])
def test_a_stand_test_that_never_began_did_not_pass(code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Because another program has the port, for one."""
    with pytest.raises(Left, match="Write the settings anyway"):
        proved(tmp_path, Runs((code, "")), monkeypatch, prove="yes")
    with pytest.raises(Left, match="did not pass the stand test"):
        proved(tmp_path, Runs((code, "")), monkeypatch, prove="yes", unproved="no")
    found = proved(tmp_path, Runs((code, "")), monkeypatch, prove="yes", unproved="yes")
    assert "Stand test: no result." in finish.text({}, "A robot", found)


@pytest.mark.parametrize("verdict", ["PASS", "FAIL", ""])
def test_a_board_that_is_deaf_after_the_stand_test_ends_setup_with_what_helps(
    verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test turned the wheels in another process, so what was known before it says nothing any more."""
    board = Board(hears=False)
    with pytest.raises(Left, match=MAY_TURN):
        proved(tmp_path, Runs((int(verdict != "PASS"), verdict)), monkeypatch, board=board, prove="yes", unproved="yes")
    assert board.stops == 1


def test_after_a_stand_test_that_did_not_pass_the_wheels_are_stopped_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board()
    with pytest.raises(Left, match=f"the robot did not pass the stand test; {CONFIRMED}"):
        proved(tmp_path, Runs((1, "FAIL"), (1, "FAIL")), monkeypatch, typed=["yes", "no", "no"], board=board)
    assert board.stops == 2


@pytest.mark.parametrize(("verdict", "kept"), [("FAIL", False), ("INVALID", True), ("", True)])
def test_answers_that_a_failed_stand_test_puts_in_doubt_are_asked_again(
    verdict: str, kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = Draft("left", {"STATE_DIRECTORY": str(tmp_path)})
    for key, answer in (("board", "ugv"), ("wheel_0", "left+"), ("track_m", "0.172")):
        before.keep(key, answer)
    with pytest.raises(Left, match="did not pass the stand test"):
        proved(tmp_path, Runs((1, verdict)), monkeypatch, prove="yes", unproved="no")
    left = Draft("left", {"STATE_DIRECTORY": str(tmp_path)}).answers
    assert set(left) == ({"board", "wheel_0", "track_m"} if kept else {"board"})


def test_whatever_ends_the_stand_test_the_wheels_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(Runs):
        def run(self, words: Sequence[str], said: str | None) -> tuple[int, bool]:
            raise KeyboardInterrupt

    board = Board()
    with pytest.raises(KeyboardInterrupt):
        proved(tmp_path, Interrupted(), monkeypatch, board=board, prove="yes")
    assert board.stops == 1


@pytest.mark.parametrize("no", ["no", "n", "No"])
def test_a_no_to_the_file_is_no_name_of_a_file(no: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    talk = Talk({"file": no}, Draft("left", {"STATE_DIRECTORY": str(tmp_path)}), silent=True)
    with pytest.raises(Left, match="you chose not to write the settings"):
        finish.write(talk, "made", "left")


@pytest.mark.parametrize("yes", ["yes", "Y", "a\nb"])
def test_a_yes_to_the_file_is_no_name_of_a_file(yes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    talk = Talk({"file": yes}, Draft("left", {"STATE_DIRECTORY": str(tmp_path)}), silent=True)
    with pytest.raises(Left, match="type a path, or no"):
        finish.write(talk, "made", "left")
    assert not any(tmp_path.iterdir())


def test_a_file_that_may_have_no_second_name_is_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux refuses one for a file of another user, and some file systems have none."""

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "failstop.toml"
    for made in ("first", "second", "third"):
        finish.write(Answers(path), made, "failstop")  # type: ignore[arg-type]
    found = {each.name: each.read_text() for each in tmp_path.iterdir()}
    assert found == {"failstop.toml": "third", "failstop.toml.old": "first", "failstop.toml.old.2": "second"}


@needs_root
@pytest.mark.parametrize(("mode", "end"), [(0o600, "you may not read"), (0o644, "written")])
def test_somebody_elses_settings_are_refused_at_the_question_or_kept(mode: int, end: str) -> None:
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        os.chmod(folder, 0o777)
        path = Path(folder) / "robot.toml"
        path.write_text("old")
        path.chmod(mode)
        answers = {"file": str(path), "replace": finish.REPLACE}
        talk = Talk(answers, Draft("left", {"STATE_DIRECTORY": folder}), silent=True)

        def work() -> str:
            with contextlib.redirect_stdout(StringIO()):
                try:
                    finish.write(talk, "new", "left")
                except Left as error:
                    return str(error)
            return "written"

        assert end in unprivileged(work)
        names = {each.name: each.read_text() for each in Path(folder).iterdir()}
        assert names == ({"robot.toml": "old"} if mode == 0o600 else {"robot.toml": "new", "robot.toml.old": "old"})


class Broken(Runs):
    """The disk became full while it saved its result."""

    def run(self, words: Sequence[str], said: str | None) -> tuple[int, bool]:
        found = super().run(words, said)
        for path in Path(words[words.index("--out") + 1]).glob(f"*/{finish.RESULT}"):
            path.write_text(path.read_text()[:-1])
        return found


def test_a_stand_test_that_left_half_a_result_did_not_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = proved(tmp_path, Broken((0, "PASS")), monkeypatch, prove="yes", unproved="yes")
    assert (found["passed"], found["verdict"]) == (False, finish.NO_RESULT)


def test_whoever_leaves_out_the_second_test_after_a_failed_one_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tests = Runs((1, "FAIL"), (REFUSED, ""))
    found = proved(tmp_path, tests, monkeypatch, typed=["yes", "no", "yes"])
    assert found["verdict"] == "FAIL"
    assert len(tests.words) == 2

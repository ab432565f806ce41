"""The end of setup: the stand test, and its settings file."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from failstop.files import durable
from failstop.setup import command, finish
from failstop.setup.draft import Draft
from failstop.setup.talk import Left, Talk


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


def proved(
    place: Path,
    tests: Runs,
    monkeypatch: pytest.MonkeyPatch,
    typed: Sequence[str] | None = None,
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
    found = command._prove(talk, {"board.kind": "ugv"}, "/nowhere", "left", None)  # type: ignore[arg-type]
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

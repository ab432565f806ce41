"""What is kept of a setup that was left, and what a new answer ends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from failstop.board.kinds import board_of
from failstop.setup import wheels
from failstop.setup.draft import Draft
from failstop.setup.halt import Halt
from failstop.setup.talk import Talk
from failstop.setup.wheels import Trial

WHOLE = {
    "port": "/dev/ttyUSB0",
    "board": "vesc",
    "can_id": "none",
    "robot": "other",
    "layout": "ackermann",
    "per_rps": "22",
    "wheel_0": "rear+",
    "forward": "yes",
    "turn": "yes",
    "diameter_m": "0.1",
    "vx_mps": "0.2",
}
"""Answers to questions of each sort, in their order."""
ENDS = {
    "port": ["can_id", "board", "robot", "layout", "per_rps", "wheel_0", "forward", "turn", "diameter_m", "vx_mps"],
    "board": ["can_id", "robot", "layout", "per_rps", "wheel_0", "forward", "turn", "diameter_m", "vx_mps"],
    "robot": ["layout", "per_rps", "wheel_0", "forward", "turn", "diameter_m", "vx_mps"],
    "layout": ["per_rps", "wheel_0", "forward", "turn", "diameter_m", "vx_mps"],
    "wheel_0": ["forward", "turn"],
    "diameter_m": [],
}


def draft(place: Path) -> Draft:
    return Draft("failstop", {"STATE_DIRECTORY": str(place)})


def filled(place: Path) -> Draft:
    found = draft(place)
    for key, answer in WHOLE.items():
        found.keep(key, answer)
    found.keep_found("steering.sign", -1)
    return found


@pytest.mark.parametrize("key", ENDS)
def test_another_answer_ends_what_was_answered_and_found_for_the_one_before(key: str, tmp_path: Path) -> None:
    filled(tmp_path).keep(key, WHOLE[key])
    assert draft(tmp_path).answers == WHOLE, "the same answer changes nothing"
    filled(tmp_path).keep(key, "another")
    left = draft(tmp_path)
    assert left.answers == {each: WHOLE[each] for each in WHOLE if each not in ENDS[key]} | {key: "another"}
    assert bool(left.found) == (key not in ("port", "board", "robot", "layout"))


def test_what_a_stand_test_tests_can_be_forgotten_and_the_hardware_stays(tmp_path: Path) -> None:
    filled(tmp_path).forget_tested()
    left = draft(tmp_path)
    assert left.answers == {each: WHOLE[each] for each in ("port", "board", "can_id", "robot", "layout")}
    assert left.found == {}


@pytest.mark.parametrize("again", [True, False])
def test_a_port_that_has_to_be_named_again_may_be_the_same_one(again: bool, tmp_path: Path) -> None:
    filled(tmp_path).forget("board", "port")
    later = draft(tmp_path)
    assert not {"board", "port"} & {*later.answers}
    later.keep("port", WHOLE["port"] if again else "/dev/ttyUSB1")
    later.keep("board", WHOLE["board"])
    assert draft(tmp_path).answers == (WHOLE if again else {"port": "/dev/ttyUSB1", "board": "vesc"})


def test_all_of_it_is_forgotten(tmp_path: Path) -> None:
    filled(tmp_path).forget("port")
    draft(tmp_path).forget()
    assert not Path(draft(tmp_path).path).exists()


def trial(place: Path, values: Mapping[str, object], answers: str = "", **given: str) -> Trial:
    """`answers`: those to all questions that are typed."""
    talk = Talk({"stand": "yes", **given}, draft(place), silent=not answers)
    return Trial(talk, "/nowhere", values, Halt("/nowhere", board_of(str(values["board.kind"]), 1.0, 0.0), print))


def leave(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_a_steering_servo_that_turned_the_other_way_still_does_so_when_setup_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Setup also says what helps if the servo of a VESC does not move at all."""
    values = {"board.kind": "vesc", "wheels.layout": "ackermann", "steering.servo": 1, "wheels.wheelbase_m": 0.3}
    monkeypatch.setattr(wheels, "Rig", leave)
    answers = {"per_rps": "unknown", "wheel_0": "rear+", "forward": "yes"}
    with pytest.raises(KeyboardInterrupt):
        trial(tmp_path, values, **answers, turn="no").step()
    assert "switch Enable Servo Output on" in " ".join(capsys.readouterr().out.split())
    again = trial(tmp_path, values, per_rps="unknown", forward="yes", turn="yes").step()
    assert again["steering.sign"] == 1, "the usual one is -1"


def test_a_scale_that_was_corrected_is_kept_with_the_answers_of_its_wheels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = {"board.kind": "hoverboard", "wheels.layout": "differential"}
    answers = iter(["left+", "right-"])
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: next(answers))
    monkeypatch.setattr(wheels, "Rig", leave)
    monkeypatch.setattr(Trial, "_turn", lambda *_: 2.5)
    with pytest.raises(KeyboardInterrupt):
        trial(tmp_path, values, "typed").step()
    assert next(answers, "") == ""
    found = trial(tmp_path, values, forward="yes", turn="yes").step()
    usual = board_of("hoverboard", 1.0, 0.0).per_rps
    assert found["board.per_rps"] == found["board.per_rps_confirmed"] == float(f"{usual / 2.5:.4g}")

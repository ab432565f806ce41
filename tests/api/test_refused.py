"""A refusal says so, and keeps the gate's reason apart."""

from __future__ import annotations

import pickle
import traceback

import pytest

from failstop.api.errors import FailstopError, NoService, Refused
from failstop.api.robot import Robot
from failstop.api.session import own_name
from failstop.messages import records
from failstop.messages.records import CAUSE
from failstop.policy import causes


@pytest.mark.parametrize("reason", ["a stop is latched (key1)", "arm is not in the drive pose"])
def test_a_refusal_is_its_reason_under_its_own_name(reason: str) -> None:
    refusal = Refused(reason)
    assert (str(refusal), refusal.reason, refusal.step) == (reason, reason, "")
    last = traceback.format_exception_only(refusal)[-1]
    assert last == f"failstop.api.errors.Refused: {reason}\n"
    assert last.lower().count("refused: ") == 1
    assert refusal.exit_code == 2


def test_a_refusal_says_what_to_do_and_puts_a_cause_s_own_text_in() -> None:
    refusal = Refused("motion is disabled", step="`failstop enable`")
    assert str(refusal) == "motion is disabled; next: `failstop enable`"
    again = pickle.loads(pickle.dumps(refusal))
    assert (str(again), again.step) == (str(refusal), refusal.step)
    of_a_cause = Refused(f"a stop is latched ({CAUSE})", causes.KEY(1))
    assert (str(of_a_cause), of_a_cause.template) == ("a stop is latched (key1)", f"a stop is latched ({CAUSE})")
    assert (str(NoService("no service")), FailstopError.exit_code, NoService.exit_code) == ("no service", 1, 3)


def test_an_arm_that_waits_for_the_wheels_says_how_it_may_move() -> None:
    robot = Robot.__new__(Robot)
    robot.name = "left"
    answer = causes.Reply(records.REFUSED, "wheels enabled", refused_for=records.FOR_THE_WHEELS)
    refusal = robot._refused(records.ARM_MOVE, answer)
    assert str(refusal).startswith("wheels enabled; next: `failstop disable --name left`, or robot.disable()")


@pytest.mark.parametrize(
    ("argv", "name"),
    [(["/home/ann/patrol.py"], "patrol.py"), (["-"], "python"), (["-c"], "python"), ([""], "python"), ([], "python")],
)
def test_a_program_without_a_file_is_called_after_its_language(
    argv: list[str], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", argv)
    assert own_name() == name

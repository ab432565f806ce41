"""A refusal says so, and keeps the gate's reason apart."""

from __future__ import annotations

import pickle
import traceback

import pytest

from failstop.api.errors import FailstopError, NoService, Refused
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

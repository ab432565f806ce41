"""A refusal says so, and keeps the gate's reason apart."""

from __future__ import annotations

import pytest

from failstop.api.errors import FailstopError, NoService, Refused
from failstop.policy import causes
from failstop.shm.records import CAUSE


@pytest.mark.parametrize("reason", ["a stop is latched (key1)", "arm is not in the drive pose"])
def test_a_refusal_reads_as_one(reason: str) -> None:
    refusal = Refused(reason)
    assert str(refusal) == f"refused: {reason}"
    assert refusal.args == (reason,)
    assert refusal.exit_code == 2


def test_a_cause_s_own_text_is_put_in_where_it_is_told() -> None:
    refusal = Refused(f"a stop is latched ({CAUSE})", causes.KEY(1))
    assert str(refusal) == "refused: a stop is latched (key1)"
    assert refusal.template == f"a stop is latched ({CAUSE})"


def test_other_errors_are_no_refusals() -> None:
    assert str(NoService("no service")) == "no service"
    assert (FailstopError.exit_code, NoService.exit_code) == (1, 3)

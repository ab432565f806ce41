"""A refusal says so, and keeps the gate's reason apart."""

from __future__ import annotations

import pytest

from failstop.api.errors import FailstopError, NoService, Refused


@pytest.mark.parametrize("reason", ["e-stop latched (key1)", "arm is not in the drive pose"])
def test_a_refusal_reads_as_one(reason: str) -> None:
    refusal = Refused(reason)
    assert str(refusal) == f"refused: {reason}"
    assert refusal.args == (reason,)
    assert refusal.exit_code == 2


def test_other_errors_are_no_refusals() -> None:
    assert str(NoService("no service")) == "no service"
    assert (FailstopError.exit_code, NoService.exit_code) == (1, 3)

"""What a bench keeps when one of its parts can't be measured."""

from __future__ import annotations

import subprocess

import pytest

from bench import BenchError, report
from bench.oneway import PairFailed
from bench.peers import PeerFailed
from bench.stats import Row
from failstop_lab.trial import TrialError


@pytest.mark.parametrize(
    "error",
    [BenchError("why"), PairFailed("why"), PeerFailed("why"), TrialError("why"), subprocess.TimeoutExpired("why", 1)],
)
def test_a_part_that_fails_is_a_row_that_says_why(error: Exception) -> None:
    def part() -> list[Row]:
        raise error

    [row] = report.whole(part)
    assert "why" in row.result
    assert row.met is False

"""The comparison of Pythons: who is visited when, and what is said of which."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bench import beside, pythons, visit

MUCH = visit.Amounts(kills=12, hangs=0, samples=12, seconds=6.0, seed=1)


def test_each_is_visited_in_each_round_and_each_is_the_first_as_often() -> None:
    sides = [beside.Side(name, Path("/"), sys.executable) for name in "abc"]
    order = []

    def visited(side: beside.Side, much: visit.Amounts) -> beside.Said:
        order.append((side.name, much.seed))
        return {"values": {}, "counts": {"kills": (much.kills, much.kills)}}

    said = pythons.visit_each(sides, MUCH, 3, visited)
    assert "".join(name for name, _ in order) == "abcbcacab"
    assert [seed for _, seed in order] == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert [set(one) for one in said] == [{"a", "b", "c"}] * 3
    kills = [one["b"]["counts"]["kills"][0] for one in said if one["b"]]
    assert sum(kills) == MUCH.kills


def test_an_interpreter_that_is_none_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert pythons.main(["/nowhere/python3"]) == 2
    assert "/nowhere/python3 is not installed" in capsys.readouterr().err

"""The judge of runaway wheels, against simulated ones that share no code with it (`python -m failstop_lab.runaway`)."""

from __future__ import annotations

import pytest

from failstop.board.kinds import KINDS, board_of
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from failstop.procs.telemetry import runaway
from failstop.procs.telemetry.runaway import RAN_AWAY, Limits, Margins, RunawayJudge, limits_of
from failstop.procs.telemetry.wheels import Way
from failstop_lab import runaway as lab
from tests.support.amounts import amount

MS = 1_000_000
SPEEDS = Limits(20 * MS, 0.3, 0.2, 0.0, 4.0, 0.1)


@pytest.mark.claim("RUNAWAY-1")
def test_healthy_wheels_raise_no_alarm_and_runaway_ones_are_found_in_time() -> None:
    found = lab.campaign(amount(4_800, 1_000_000), seed="test")
    assert found.false == []
    assert found.late == []
    assert sum(found.found.values()) >= 24
    assert {name.partition(": ")[2] for name in found.found} == set(lab.FAULTS)


@pytest.mark.parametrize(
    "weaker",
    [
        {"HOLDS_SPEED": Margins(0.05, 0.0), "SETS_VOLTAGE": Margins(0.3, 0.05)},
        {"SLOWS": 0.0, "LAG_NS": 0},
        {"LAG_NS": 1_500 * MS},
        {"HOLDS_SPEED": Margins(1.0, 0.2), "SETS_VOLTAGE": Margins(2.0, 0.4)},
    ],
    ids=["margins too small", "no lag, and who slows down is stopped too", "a lag too long", "margins too wide"],
)
def test_the_trial_sees_thresholds_that_are_wrong(monkeypatch: pytest.MonkeyPatch, weaker: dict[str, object]) -> None:
    for name, value in weaker.items():
        monkeypatch.setattr(runaway, name, value)
    found = lab.campaign(20_000, seed="control")
    assert found.false or found.late


def test_only_boards_that_report_often_enough_are_judged() -> None:
    judged = {kind for kind in BOARDS if limits_of(Settings({"board.kind": kind}), board_of(kind, 0.08, 0.0))}
    assert judged == set(KINDS)


def told(judge: RunawayJudge, speeds: list[tuple[float, float]], seen: list[float], enabled: bool = True) -> list[str]:
    """Commands of one wheel and reports of it, one every 20 ms; what was found."""
    found = []
    for number, (now, report) in enumerate(zip(speeds, seen, strict=True)):
        t_ns = (number + 100) * 20 * MS
        judge.follow((now[0], now[1]), t_ns, t_ns, enabled=enabled)
        if finding := judge.add((report, 0.0), (), t_ns):
            found.append(finding.what)
    return found


def test_a_wheel_told_zero_beside_one_that_turns_may_not_turn() -> None:
    speeds = [(0.0, 1.0)] * 100
    assert told(RunawayJudge(SPEEDS, (0, 1)), speeds, [0.0] * 50 + [0.5] * 50)[:1] == [RAN_AWAY]


def test_wheels_that_came_to_rest_and_are_pushed_have_not_run_away() -> None:
    speeds = [(1.0, 1.0)] * 50 + [(0.0, 0.0)] * 300
    seen = [1.0] * 60 + [0.0] * 40 + [2.0] * 250
    assert told(RunawayJudge(SPEEDS, (0, 1)), speeds, seen) == []


def test_nothing_is_judged_while_motion_is_disabled() -> None:
    assert told(RunawayJudge(SPEEDS, (0, 1)), [(0.0, 0.0)] * 300, [3.0] * 300, enabled=False) == []


def test_commands_that_nobody_has_seen_are_compared_with_nothing() -> None:
    judge = RunawayJudge(SPEEDS, (0,))
    for number in range(500):
        t_ns = (number + 100) * 20 * MS
        if number % 10 == 0:
            judge.follow((1.0,), t_ns, t_ns, enabled=True)
        assert judge.add((9.0,), (), t_ns) is None


def test_an_encoder_on_the_edge_of_a_count_goes_nowhere() -> None:
    way = Way(board_of("arduino", 0.08, 0.0).reports)
    count = 1 / board_of("arduino", 0.08, 0.0).reports.position_per_turn
    assert not way.went((0.0, 0.0), rest=True)
    assert not any(way.went((number % 2 * count, 0.0), rest=False) for number in range(50))
    assert way.went((3 * count, 0.0), rest=False)

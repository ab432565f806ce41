"""A UGV's reports, as its firmware computes them: whole centimetres, and the speed of the last loop alone."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from failstop.board.interface import HEARD_RESTARTED, HEARD_WHEELS
from failstop.board.kinds import board_of
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.still import StillJudge
from failstop.procs.telemetry.wheels import ARE_STILL, THEY_TURN, Measured, Way, WheelFact
from tests.support.stage import MS

BOARD = board_of("ugv", 0.08, 0.0)
REPORTS = BOARD.reports
COUNT_M = 0.08 * 3.14159265359 / 660
AFTER_NS = 1_500 * MS
T0_NS = 10_000 * MS


def lines(speed_mps: float, seconds: float, seed: int, loop_s: float = 0.001) -> Iterator[tuple[int, bytes]]:
    """(when, the report) of both wheels at this speed. L and R: the counts of the last loop (movtion_module.h,
    getLeftSpeed); odl and odr: whole cm (ugv_advance.h, baseInfoFeedback)."""
    chance = random.Random(seed)
    at_s, phases = 0.0, (chance.random(), chance.random())
    while at_s < seconds:
        at_s += 0.05 + chance.uniform(0.0, 0.004)
        ways = [speed_mps * at_s + phase for phase in phases]
        loops = [(way // COUNT_M - (way - speed_mps * loop_s) // COUNT_M) * COUNT_M / loop_s for way in ways]
        (left, right), (odl, odr) = loops, (int(100 * way) for way in ways)
        text = f'{{"T":1001,"L":{left:g},"R":{right:g},"odl":{odl},"odr":{odr},"v":1180}}\r\n'
        yield T0_NS + round(at_s * 1e9), text.encode()


class Judged:
    """What telemetry makes of them, while zero is commanded."""

    def __init__(self) -> None:
        self.read_back, self.fact = ReadBack(REPORTS.apart_ns), WheelFact(AFTER_NS)
        self.measured, self.way = Measured(REPORTS), Way(REPORTS)
        self._hearing = BOARD.hearing()

    def add(self, line: bytes, t_ns: int) -> None:
        for kind, said in self._hearing.feed(line):
            if kind == HEARD_WHEELS:
                speeds, positions = said
                self.measured.add(speeds, positions, t_ns)
                self.read_back.add(speeds, positions, t_ns)
        went = self.way.went(self.measured.turns, rest=self.fact.does != THEY_TURN)
        self.fact.update(self.read_back, StillJudge(0.0035), 1, t_ns, went=went)


@pytest.mark.parametrize("speed_mps", [0.045, 0.05, 0.1, 0.15, 0.2, 0.5])
def test_wheels_that_turn_slowly_are_never_still_and_are_known_to_turn_unasked(speed_mps: float) -> None:
    for seed in range(20):
        judged, unexpected_ns = Judged(), 0
        for t_ns, line in lines(speed_mps, 5.0, seed, loop_s=(0.001, 0.002, 0.005)[seed % 3]):
            judged.add(line, t_ns)
            assert not judged.read_back.still_ns, (seed, t_ns)
            unexpected_ns = unexpected_ns or t_ns * judged.fact.unexpected
        assert 0 < unexpected_ns - T0_NS <= AFTER_NS + 1_000 * MS, seed
        assert judged.measured.speeds_rps[0] == pytest.approx(speed_mps / (0.08 * 3.14159265), rel=0.25, abs=0.16)


def test_wheels_at_rest_are_still_as_soon_as_two_reports_far_enough_apart_agree() -> None:
    judged = Judged()
    for t_ns, line in lines(0.0, 1.0, 1):
        judged.add(line, t_ns)
    assert judged.fact.does == ARE_STILL
    assert 250 * MS <= judged.read_back.still_ns - T0_NS <= 400 * MS


def test_a_boot_mission_that_is_broken_off_is_a_restart_that_says_so() -> None:
    (kind, said), *others = BOARD.hearing().feed(b"[missionPlay abort.]\r\n")
    assert (kind, others) == (HEARD_RESTARTED, [])
    assert "backwards" in said[0]


def test_a_report_without_odometers_is_none_of_the_wheels() -> None:
    """ugv_base_general's types 1 and 2 report the commanded PWM as L and R, so zeros there prove nothing."""
    judged = Judged()
    for at in range(20):
        judged.add(b'{"T":1001,"L":0,"R":0,"r":0.1,"p":0.2,"v":11.8}\r\n', T0_NS + at * 50 * MS)
    assert (judged.read_back.judged_ns, judged.measured.speeds_rps) == (0, ())

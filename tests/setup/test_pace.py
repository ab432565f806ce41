"""How fast the wheels turn compared with their command, when single reports say little."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.board.kinds import board_of
from failstop.setup.halt import Halt
from failstop.setup.pace import Pace
from failstop.setup.rig import RAMP_MPS2, Rig, alone, rim_mps
from failstop.setup.wheels import FASTEST_RPS, RPS, SECONDS
from failstop_lab.sim.client import SimBoard

DIAMETER_M = 0.08
MS = 1_000_000
REPORT_MS = 50
BEGINS_MS = 1000


def told_rps(at_ms: int, rps: float) -> float:
    """The ramp of the gate, and the end."""
    driven_s = (at_ms - BEGINS_MS) / 1000
    return min(rps, driven_s * RAMP_MPS2 / rim_mps(1.0, DIAMETER_M)) if 0 <= driven_s < SECONDS else 0.0


def measured(kind: str, times: float, rps: float, phase: float) -> float:
    """The ratio that a drive measures. The first wheel turns so many `times` as fast as it is told, and begins at
    `phase` counts. As on a UGV, a reported speed is that of one loop, which jumps by half, and a position is cut to
    whole cm."""
    reports = board_of(kind, DIAMETER_M, 0.0).reports
    pace, turned = Pace(reports), 0.0
    for at_ms in range(0, BEGINS_MS + 2000, REPORT_MS):
        told = told_rps(at_ms, rps)
        jump = 1.5 if at_ms // REPORT_MS % 3 == 2 else 0.75
        speeds = (times * told * reports.speed_per_rps * jump, 0.0)
        positions = (float(int(turned * reports.position_per_turn + phase)), 3.0) if reports.position_per_turn else ()
        pace.add(speeds, positions, told, (BEGINS_MS + at_ms) * MS)
        turned += times * told * REPORT_MS / 1000
    return pace.ratio


PHASES = pytest.mark.parametrize("phase", [at / 10 for at in range(10)])


@PHASES
@pytest.mark.parametrize("rps", [RPS, 2 * RPS, FASTEST_RPS])
@pytest.mark.parametrize("kind", ["ugv", "hoverboard", "damiao"])
def test_a_speed_that_jumps_from_report_to_report_shows_no_wrong_scale(kind: str, rps: float, phase: float) -> None:
    assert measured(kind, 1.0, rps, phase) == 1.0


@PHASES
@pytest.mark.parametrize("rps", [RPS, FASTEST_RPS])
@pytest.mark.parametrize("kind", ["ugv", "hoverboard", "damiao"])
def test_wheels_that_are_too_fast_are_measured(kind: str, rps: float, phase: float) -> None:
    assert measured(kind, 2.5, rps, phase) == pytest.approx(2.5, rel=0.1)


@PHASES
@pytest.mark.parametrize("kind", ["ugv", "hoverboard", "damiao"])
def test_wheels_that_are_too_slow_are_measured_as_too_slow_or_as_less_slow(kind: str, phase: float) -> None:
    """In whole cm, which are coarse for a slow wheel, never as slower than they are."""
    assert 0.3 <= measured(kind, 0.3, RPS, phase) + 1e-9 < (0.6 if kind == "ugv" else 0.32)


def test_a_wheel_that_still_speeds_up_is_not_called_too_slow() -> None:
    assert measured("damiao", 0.6, FASTEST_RPS, 0.0) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "times"), [("ugv", 1.6), ("hoverboard", 1.0)])
def test_a_wheel_that_turns_alone_is_measured_and_its_stop_is_acknowledged(
    kind: str, times: float, place: Path
) -> None:
    board, port = board_of(kind, DIAMETER_M, 0.0), str(place / "b")
    values, velocity = alone(kind, 2, 1, rim_mps(RPS, DIAMETER_M), DIAMETER_M)
    with SimBoard(port, board=kind, per_rps=board.per_rps / times) as simulated:
        # A long lease, because this test is about no process that hangs.
        with Rig(port, {**values, "gate.lease_s": 0.25}, Halt(port, board, pytest.fail)) as rig:
            rig.drive(velocity, SECONDS)
            assert not any(simulated.wheels())
        assert rig.ratio == pytest.approx(times, rel=0.2)


def test_a_board_that_reports_nothing_is_not_compared() -> None:
    assert Pace(board_of("ugv", DIAMETER_M, 0.0).reports).ratio == 0.0

"""The measured speed of wheels over the commanded one, from a board's reports and the frames that were sent."""

from __future__ import annotations

from math import pi

import pytest

from failstop.board.kinds import board_of
from failstop.policy.settings import Settings
from failstop_lab.boards.hoverboard import LOOP_NS, Hoverboard
from failstop_lab.prove import pace
from failstop_lab.prove.sight import SeenSample
from failstop_lab.prove.table import within
from failstop_lab.prove.watch import Commanded

MS = 1_000_000
REPEAT_NS = 200 * MS
LAG_NS = 40 * MS


def driven(per_rps: float, rps: float) -> tuple[list[Commanded], list[SeenSample]]:
    """Two seconds of a steady speed at the simulated receiver, whose reports are read a little late."""
    board = board_of("hoverboard", 0.08, per_rps)
    receiver, hearing = Hoverboard(LOOP_NS, turns=True), board.hearing()
    steady = board.motor_speeds((rps, rps), 2 * rps)
    commanded: list[Commanded] = []
    for turn in range(10):
        frame, at_ns = board.marked(steady, turn), turn * REPEAT_NS + MS
        commanded.append((at_ns, tuple(board.speeds(frame) or ())))
        for index, value in enumerate(frame):
            receiver.byte(at_ns + index * 90_000, value)
        receiver.until(at_ns + REPEAT_NS - MS)
    samples: list[SeenSample] = []
    for at_ns, data in receiver.said:
        samples += [(at_ns + LAG_NS, *said) for _, said in hearing.feed(data) if len(said) == 2 and said[1] == ()]
    return commanded, samples


@pytest.mark.parametrize(("per_rps", "rps"), [(12.0, 0.8), (12.0, 0.65), (60.0, 0.3), (300.0, 0.2)])
@pytest.mark.parametrize("begins_ms", [0, 200, 400, 600, 700])
@pytest.mark.parametrize("lasts_ms", [600, 1200])
def test_frames_that_repeat_a_slow_speed_do_not_distort_it(
    per_rps: float, rps: float, begins_ms: int, lasts_ms: int
) -> None:
    """Each of these frames is 0, 1 or 2 units slower than the speed, up to a quarter of it. The board's reports
    can't show half an rpm, and they lag."""
    commanded, samples = driven(per_rps, rps)
    begin_ns = (begins_ms + 40) * MS
    window = [sample for sample in samples if begin_ns <= sample[0] < begin_ns + lasts_ms * MS]
    reports = board_of("hoverboard", 0.08, per_rps).reports
    found = pace.measured(window, reports, commanded)
    slowest_rpm = min(speeds[0] for _, speeds in commanded) * per_rps
    assert found == pytest.approx(per_rps / 60.0, rel=max(0.05, 0.5 / slowest_rpm))


def test_a_report_from_before_the_first_frame_says_nothing() -> None:
    _, samples = driven(60.0, 1.0)
    reports = board_of("hoverboard", 0.08, 60.0).reports
    assert pace.measured(samples, reports, []) is None
    assert pace.measured(samples, reports, [(samples[-1][0] + 1, (1.0, 1.0))]) is None


def test_a_car_is_judged_by_its_motor_and_drives_a_curve_where_others_turn() -> None:
    settings = Settings({"board.kind": "vesc", "wheels.layout": "ackermann", "limits.vx_mps": 1.0})
    board = board_of(*settings.board())
    assert [velocity.command for velocity in within(settings)][-1] == (0.2, 0.0, 1.0)
    for velocity in within(settings):
        (rps,) = pace.commanded_rps(settings, velocity, board)
        assert rps == pytest.approx(velocity.command[0] / (pi * 0.1), rel=0.01)

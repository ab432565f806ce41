"""Output: which frames go out, and when."""

from __future__ import annotations

from itertools import pairwise

from failstop.procs.gate.core import NO_SPEEDS

from .gate_bench import Gate


def test_the_first_frame_after_enable_is_zero_and_at_once(gate: Gate) -> None:
    gate.enable()
    assert gate.step() == NO_SPEEDS


def test_a_frame_every_refresh_while_nothing_changes(driving: Gate) -> None:
    sent = []
    for tick in range(1, 41):
        driving.take((0.2, 0.0, 0.0))
        if driving.step() is not None:
            sent.append(tick)
    assert all(b - a == 10 for a, b in pairwise(sent)), "200 ms are 10 ticks"
    assert len(sent) == 4


def test_zero_frames_too_are_refreshed_while_blocked(gate: Gate) -> None:
    gate.enable()
    frames = [gate.step() for _ in range(50)]
    assert [n for n, frame in enumerate(frames) if frame is not None] == [0, 10, 20, 30, 40]
    assert {frame for frame in frames if frame is not None} == {NO_SPEEDS}


def test_a_changed_speed_is_sent_at_every_tick(gate: Gate) -> None:
    gate.enable()
    for _ in range(20):
        gate.take((0.2, 0.0, 0.0))
        assert gate.step() is not None


def test_the_refresh_is_the_setting_s() -> None:
    gate = Gate(gate__refresh_s=0.1)
    gate.enable()
    assert [n for n in range(20) if gate.step() is not None] == [0, 5, 10, 15]

"""The gate's core: enabled by an enable alone, latched until a reset, and which frames go out when.

Any sequence of events keeps all of its rules (gate_machine.py).
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from tests.support.why import said, told, why

from .gate_bench import NO_SPEEDS, Gate, stands
from .gate_machine import GateMachine

FORWARD = (0.2, 0.0, 0.0)
test_any_sequence_keeps_the_rules = pytest.mark.slow(GateMachine.TestCase)


def test_a_gate_starts_disabled_and_moves_nothing(gate: Gate) -> None:
    assert gate.blocked == "disabled"
    assert gate.core.latch is None
    for _ in range(20):
        assert gate.take(FORWARD) == ""
        assert gate.step() is None
    assert stands(gate)
    assert told(gate.core.enable(1, "the port", gate.now)) == (False, "not ready: the port")
    assert gate.blocked == "disabled"


def test_an_enable_takes_the_epoch_and_no_command_of_before(gate: Gate) -> None:
    gate.take(FORWARD)
    gate.enable(epoch=7)
    assert (gate.core.enabled, gate.core.epoch) == (True, 7)
    assert gate.blocked == "cmd timeout"
    gate.step()
    assert stands(gate)
    gate.drive(FORWARD, 40)
    assert told(gate.core.enable(9, "", gate.now)) == (True, "motion enabled"), "a second one changes nothing"
    assert (gate.core.epoch, gate.core.velocity) == (7, FORWARD)


def test_a_disable_stops_the_wheels_at_once(driving: Gate) -> None:
    assert told(driving.core.disable()) == (True, "motion disabled")
    assert driving.blocked == "disabled"
    assert stands(driving)
    assert driving.step() is None


# The latch.


def test_a_stop_latches_until_a_reset_which_clears_it_and_nothing_else(driving: Gate) -> None:
    core = driving.core
    assert core.stop(why("key1"), 3)
    assert stands(driving)
    assert not core.enabled
    assert driving.step() is None
    assert not core.stop(why("another"), 4)
    assert said(core.latch) == "key1", "the first reason"
    core.disable()
    driving.gone(1)
    assert told(core.enable(4, "", driving.now)) == (False, "a stop is latched (key1)")
    driving.take(FORWARD)
    for _ in range(100):
        driving.step()
    core.follow(None, 3)
    assert driving.blocked == "estop: key1", "the supervisor has not answered it"

    core.follow(None, 4)
    assert core.latch is None
    assert driving.blocked == "disabled"
    driving.take(FORWARD)
    assert driving.step() is None
    assert stands(driving)
    driving.enable(4)
    assert core.epoch == 4
    assert driving.blocked == "cmd timeout"
    assert driving.drive(FORWARD, 1)[0][0] == pytest.approx(0.01), "the ramp starts from zero"
    assert driving.blocked == ""


def test_a_reason_without_words_latches_too(driving: Gate) -> None:
    assert driving.core.stop(why(""), 1)
    assert driving.blocked == "estop: stop request"
    assert told(driving.core.enable(2, "", driving.now)) == (False, "a stop is latched (stop request)")


def test_the_supervisor_s_latch_counts(driving: Gate) -> None:
    core = driving.core
    core.follow(None, 1)
    assert (core.enabled, core.velocity) == (True, FORWARD), "nothing latched is no news"
    core.follow(why("gate died"), 1)
    assert stands(driving)
    assert not core.enabled
    core.follow(None, 1)
    assert driving.blocked == "disabled", "it ends by its word, in the first epoch too"
    core.stop(why("key1"), 3)
    core.follow(why("gate died"), 3)
    assert driving.blocked == "estop: gate died"


# The frames that go out.


def test_a_frame_goes_out_every_refresh_while_nothing_changes(driving: Gate) -> None:
    sent = []
    for tick in range(1, 41):
        driving.take(FORWARD)
        if driving.step() is not None:
            sent.append(tick)
    assert all(b - a == 10 for a, b in pairwise(sent)), "200 ms are 10 ticks"
    assert len(sent) == 4


@pytest.mark.parametrize(("changed", "ticks"), [({}, 10), ({"gate__refresh_s": 0.1}, 5)])
def test_zero_frames_go_out_at_once_and_every_refresh_while_blocked(changed: dict[str, object], ticks: int) -> None:
    gate = Gate(**changed)
    gate.enable()
    frames = [gate.step() for _ in range(50)]
    assert [n for n, frame in enumerate(frames) if frame is not None] == list(range(0, 50, ticks))
    assert {frame for frame in frames if frame is not None} == {NO_SPEEDS}


def test_a_changed_speed_is_sent_at_every_tick(gate: Gate) -> None:
    gate.enable()
    for _ in range(20):
        gate.take(FORWARD)
        assert gate.step() is not None

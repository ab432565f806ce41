"""Sources, the scan gate and interlocks, sentence by sentence."""

from __future__ import annotations

from math import inf, nan

import pytest

from failstop.policy import kinematics
from failstop.policy.settings import PAD_SOURCE, Settings
from failstop.procs.gate.conditions import AHEAD_NS
from failstop.procs.gate.core import REST, GateCore
from failstop.procs.gate.sources import PAD_PRIORITY, Command
from tests.support.why import told

from .gate_bench import MS, NO_SPEEDS, T0, TICK, Gate

WITH_TELEOP: dict[str, object] = {
    "sources.cmd_vel.priority": 0,
    "sources.cmd_vel.timeout_s": 0.3,
    "sources.teleop.priority": 10,
    "sources.teleop.timeout_s": 0.2,
}
ARM: dict[str, object] = {"interlocks.arm.timeout_s": 0.5, "interlocks.arm.refusal": "arm is not in the drive pose"}


def scanning(changed: dict[str, object] | None = None) -> Gate:
    """An enabled gate, which needs the obstacle sensor."""
    gate = Gate(scan__gate="on", **(changed or {}))
    gate.enable()
    return gate


def scan(gate: Gate) -> None:
    gate.core.scan.deliver(gate.now, gate.now)


def fields(gate: Gate) -> list[dict[str, str | int | float]]:
    """Fields of the notes, for programs."""
    return [note.fields for note in gate.core.notes]


def cruise(gate: Gate, vx: float, source: str = "cmd_vel", session: int = 1) -> None:
    for _ in range(25):
        scan(gate)
        assert gate.command(vx, source, session) == ""
        gate.tick()
    assert gate.core.velocity[0] == pytest.approx(vx)


def fall_silent(gate: Gate, ticks: int = 40) -> None:
    """The sensor does, and the commands go on."""
    for _ in range(ticks):
        gate.command(0.1)
        gate.tick()


# Sources.


def test_a_higher_source_takes_over_at_once() -> None:
    gate = scanning(WITH_TELEOP)
    cruise(gate, 0.1)
    gate.command(-0.1, "teleop", session=2)
    assert gate.tick() == pytest.approx(0.09), "from the speed it has, along the ramp"
    assert gate.core.sources.table(gate.now) == [
        {"source": "teleop", "priority": 10, "who": "client 2", "state": "drives"},
        {"source": "cmd_vel", "priority": 0, "who": "client 1", "state": "waits"},
    ]


def test_a_lower_source_begins_from_zero_after_the_higher_s_silence() -> None:
    gate = scanning(WITH_TELEOP)
    cruise(gate, -0.1, "teleop", session=2)
    for _ in range(9):
        scan(gate)
        gate.command(0.1)
        assert gate.tick() == pytest.approx(-0.1), "still the higher one's"
    scan(gate)
    gate.command(0.1)
    assert gate.tick(TICK) == pytest.approx(0.01), "more than 0.2 s of silence: from zero, not from -0.1"


def test_two_publishers_of_one_source_latch_and_of_two_sources_do_not() -> None:
    gate = scanning(WITH_TELEOP)
    assert gate.command(0.1, "cmd_vel", session=1) == ""
    assert gate.command(0.1, "teleop", session=2) == ""
    assert gate.command(0.1, "teleop", session=3) == "multiple teleop publishers: client 2, client 3"
    assert gate.command(0.1, "cmd_vel", session=2) == "multiple cmd_vel publishers: client 1, client 2"


def test_another_publishes_while_disabled_or_once_the_last_command_no_longer_counts(gate: Gate) -> None:
    gate.take(REST)
    assert gate.take(REST, session=2) == "multiple cmd_vel publishers: client 1, client 2"
    gate.step(300 * MS)
    assert gate.take(REST, session=2).startswith("multiple")
    gate.step(1)
    assert gate.take((0.1, 0.0, 0.0), session=2) == ""


def test_another_drives_at_once_from_zero_when_the_driver_has_ended(driving: Gate) -> None:
    driving.gone(2, parted=True)
    assert driving.blocked == "", "a client that does not drive"
    driving.gone(1, parted=True)
    assert driving.step(0) == NO_SPEEDS
    assert driving.blocked == "cmd timeout"
    assert driving.core.latch is None
    assert driving.take((0.2, 0.0, 0.0), session=2) == ""
    driving.step()
    assert driving.core.velocity[0] == pytest.approx(0.01)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_value_that_is_not_finite_is_a_reason_to_stop(driving: Gate, axis: int, value: float) -> None:
    wanted = [0.1, 0.1, 0.1]
    wanted[axis] = value
    before = driving.core.sources.driving(driving.now)
    assert driving.take((wanted[0], wanted[1], wanted[2])) == "command from client 1 is not finite"
    assert driving.core.sources.driving(driving.now) is before


@pytest.mark.parametrize(("source", "timeout_ms"), [("teleop", 200), ("cmd_vel", 300)])
def test_each_source_has_its_own_timeout(source: str, timeout_ms: int) -> None:
    gate = scanning(WITH_TELEOP)
    gate.command(0.1, source, manual=True)
    gate.tick(timeout_ms * MS)
    assert gate.blocked == ""
    gate.tick(1)
    assert gate.blocked == "cmd timeout"


def test_the_default_is_one_source_and_the_pad_is_above_all() -> None:
    """The settings refuse its name and its rank for a source of the user's."""
    assert list(Settings().sources()) == ["cmd_vel"]
    assert (PAD_SOURCE, PAD_PRIORITY) == ("gamepad", 101)
    gate = scanning(WITH_TELEOP)
    gate.command(0.1, "teleop", session=2, manual=True)
    gate.command(0.05, PAD_SOURCE, session=0, manual=True)
    assert gate.core.sources.driving(gate.now).source == PAD_SOURCE  # type: ignore[union-attr]


def test_no_client_can_command_as_the_pad() -> None:
    gate = scanning(WITH_TELEOP)
    scan(gate)
    assert gate.command(0.1, PAD_SOURCE, session=7, manual=True) == ""
    assert gate.tick() == 0
    assert gate.told() == ["command from client 7 ignored: the source 'gamepad' is the board's gamepad alone"]
    assert gate.command(0.1, "teleop", session=0, manual=True) == "", "nor is the pad a client"
    assert gate.tick() == 0


def test_an_unknown_source_moves_nothing_and_is_told_of_once_by_session_and_name() -> None:
    gate = scanning()
    scan(gate)
    for session in (1, 2, 1, 2):
        for source in ("a", "b", "a"):
            assert gate.command(0.1, source=source, session=session) == ""
    assert gate.tick() == 0
    found = [(note.text, note.fields) for note in gate.core.notes]
    assert found == [
        (
            f"command from client {session} ignored: no source '{source}' in the settings",
            {"who": f"client {session}", "source": source},
        )
        for session in (1, 2)
        for source in "ab"
    ]


def test_ever_new_unknown_sources_are_not_told_of_for_ever() -> None:
    gate = scanning()
    for number in range(100):
        gate.command(0.1, source=f"s{number}")
    assert len(gate.core.notes) == 64


# The scan gate.


def test_a_sensor_silent_for_half_a_second_blocks_and_does_not_latch() -> None:
    gate = scanning()
    cruise(gate, 0.1)
    seen_ns = gate.now - TICK
    while gate.now + TICK - seen_ns <= 500 * MS:
        gate.command(0.1)
        assert gate.tick() == pytest.approx(0.1)
    gate.command(0.1)
    assert gate.tick() == 0, "zero at once, no ramp"
    assert gate.blocked == "no scan"
    assert gate.core.latch is None
    assert gate.core.enabled
    assert gate.core.speeds == NO_SPEEDS


def test_motion_resumes_by_itself_from_zero_and_both_are_told_once_with_the_age() -> None:
    gate = scanning()
    for _ in range(2):
        gate.core.notes.clear()
        cruise(gate, 0.1)
        fall_silent(gate)
        assert gate.told() == ["no scan for 0.52 s: wheels stopped"]
        scan(gate)
        gate.command(0.1)
        assert gate.tick() == pytest.approx(0.01), "along the ramp"
        assert gate.told()[1:] == ["scan is back (age 0.02 s): motion resumes by itself"]
        assert fields(gate) == [
            {"state": "silent", "age_s": pytest.approx(0.52)},
            {"state": "back", "age_s": pytest.approx(0.02)},
        ]
        assert [note.level for note in gate.core.notes] == ["", "info"]


@pytest.mark.parametrize("ahead", [False, True])
def test_before_the_first_scan_nothing_moves(ahead: bool) -> None:
    """A sensor whose clock is ahead moves nothing either, and nobody is told of a silence as long as the uptime."""
    gate = scanning()
    if ahead:
        gate.core.scan.deliver(gate.now + AHEAD_NS + 1, gate.now)
    gate.command(0.1)
    assert gate.tick() == 0
    assert gate.blocked == "no scan"
    assert gate.told() == ["no scan yet: wheels stand"]
    assert fields(gate) == [{"state": "silent"}]


@pytest.mark.parametrize(("changed", "manual"), [({}, True), ({"scan.gate": "off"}, False)])
def test_manual_commands_and_a_gate_without_it_need_no_scan(changed: dict[str, object], manual: bool) -> None:
    gate = scanning(changed)
    gate.command(0.1, manual=manual)
    assert gate.tick() == pytest.approx(0.01)
    assert gate.blocked == ""


def test_the_command_timeout_comes_before_no_scan() -> None:
    gate = scanning()
    gate.command(0.1)
    gate.tick(400 * MS)
    assert gate.blocked == "cmd timeout"


# Interlocks.


def test_enabling_needs_every_interlock_and_its_loss_disables_and_does_not_latch() -> None:
    gate = Gate(scan__gate="on", **ARM)
    assert told(gate.core.enable(1, "", gate.now)) == (False, "arm is not in the drive pose")
    gate.core.interlocks.confirm(["arm"], gate.now, gate.now)
    assert told(gate.core.enable(1, "", gate.now)) == (True, "motion enabled")
    scan(gate)
    gate.command(0.1)
    assert gate.tick(500 * MS) == 0
    assert gate.blocked == "cmd timeout"
    gate.tick(1)
    assert gate.blocked == "disabled"
    assert gate.core.latch is None
    assert gate.core.velocity == REST
    assert gate.told() == ["motion disabled: arm is not in the drive pose"]
    assert fields(gate) == [{"reason": "arm is not in the drive pose"}]
    gate.core.interlocks.confirm(["arm"], gate.now, gate.now)
    gate.tick()
    assert gate.blocked == "disabled", "what comes back does not enable"


def test_a_stamp_that_is_a_little_ahead_counts_as_now() -> None:
    """Written after the turn that reads it began."""
    gate = Gate(scan__gate="on", **ARM)
    gate.core.interlocks.confirm(["arm"], gate.now + AHEAD_NS, gate.now)
    gate.core.scan.deliver(gate.now + AHEAD_NS, gate.now)
    assert gate.core.interlocks.unmet(gate.now) == ""
    assert not gate.core.scan.silent(gate.now)
    gate.now += 501 * MS
    assert gate.core.interlocks.unmet(gate.now) == "arm is not in the drive pose"
    assert gate.core.scan.silent(gate.now)


def test_a_stamp_from_the_future_never_holds_however_often_it_is_looked_at() -> None:
    gate = Gate(scan__gate="on", **ARM)
    stamp_ns = gate.now + 10_000 * MS
    for _ in range(100):
        gate.core.interlocks.confirm(["arm"], stamp_ns, gate.now)
        gate.core.scan.deliver(stamp_ns, gate.now)
        gate.now += TICK
    assert gate.core.interlocks.unmet(gate.now) == "arm is not in the drive pose"
    assert gate.core.scan.silent(gate.now)


def test_a_layout_without_a_sideways_axis_stands_sideways() -> None:
    settings = Settings({"wheels.layout": "differential", "scan.gate": "off"})
    core = GateCore(settings, kinematics.from_settings(settings), T0)
    core.enable(1, "", T0)
    for tick in range(1, 30):
        core.take(Command(1, "one", T0 + tick * TICK, (0.1, 0.2, 0.0)), T0 + tick * TICK)
        core.step(T0 + tick * TICK)
    assert core.velocity == pytest.approx((0.1, 0.0, 0.0))


def test_a_command_is_no_manual_one_unless_it_says_so() -> None:
    command = Command(1, "one", T0, (0.0, 0.0, 0.0))
    assert not command.manual
    assert command.source == "cmd_vel"


def test_a_silent_sensor_is_not_back_because_something_else_blocks() -> None:
    gate = scanning()
    cruise(gate, 0.1)
    fall_silent(gate, 30)
    gate.core.notes.clear()
    gate.tick(400 * MS)
    assert gate.blocked == "cmd timeout"
    assert gate.told() == []

"""Wheels that do not do what they are told, with the whole service on the simulated machine: the board judges."""

from __future__ import annotations

from math import cos, pi, radians
from random import Random
from typing import Any

import pytest

from failstop.board.kinds import KINDS, board_of
from failstop.policy import causes
from tests.support.amounts import amount
from tests.support.simulated import Simulated

AFTER_S = 1.5
SETTINGS = {"scan.gate": "off", "still.command": "echo CONTACTOR"}
SPEED = {"feetech": 0.1}
"""m/s forward, where it is not 0.2: as fast as LeKiwi's servos turn."""
LEFT = {"feetech": cos(radians(150)) * 0.1 / (pi * 0.1)}
"""Turns a second that the left wheel is told then, where it is not what a wheel of 8 cm is told."""
every_reporter = pytest.mark.parametrize("kind", KINDS)


def forward(kind: str) -> tuple[float, float, float]:
    return SPEED.get(kind, 0.2), 0.0, 0.0


def told_rps(kind: str) -> float:
    """What the left wheel is told then."""
    return LEFT.get(kind, 0.2 / (pi * 0.08))


def service(kind: str) -> Simulated:
    return Simulated(SETTINGS, kind=kind)


def events(simulated: Simulated, *kinds: str) -> list[Any]:
    """The events of these kinds."""
    log = simulated.load("failstop.api.events").EventLog(simulated.name)
    return [event for event in log.read() if event.kind in kinds]


def run_down_s(kind: str) -> float:
    """As procs/telemetry/runaway.md has it, for this drive with the default braking of 1 m/s2."""
    return 0.3 + 0.2 + SPEED.get(kind, 0.2) / 1.0 + 3 * every_s(kind)


def every_s(kind: str) -> float:
    return board_of(kind, 0.08, 0.0).reports.judged_ns / 1e9


def drives(simulated: Simulated, kind: str) -> None:
    simulated.enable()
    simulated.drive(1.5, forward(kind))
    assert simulated.turning()
    assert simulated.robot.state.estop is None
    simulated.board.events()


@pytest.mark.claim("RUNAWAY-1")
@every_reporter
@pytest.mark.parametrize("faster", [5.0, -2.0])
def test_a_wheel_that_runs_away_while_it_drives_stops_the_robot(kind: str, faster: float) -> None:
    simulated = service(kind)
    drives(simulated, kind)
    fault_ns = simulated.now_ns()
    simulated.board.roll(faster)
    simulated.drive(run_down_s(kind) + 0.5, forward(kind))
    simulated.stops(fault_ns, 1000 * (run_down_s(kind) + 0.2) + simulated.own_ns / 1e6)
    cause = simulated.robot.state.cause
    assert cause is not None
    assert cause.kind is causes.RUNAWAY
    assert (cause.named()["wheel"], cause.named()["told"]) == ("left", pytest.approx(told_rps(kind), abs=0.01))
    assert cause.named()["seen"] == pytest.approx(faster * told_rps(kind), rel=0.1)
    assert "the left wheel turned" in simulated.printed("why")


@every_reporter
def test_a_wheel_that_runs_on_when_its_driver_ends_stops_the_robot(kind: str) -> None:
    simulated = service(kind)
    drives(simulated, kind)
    simulated.board.roll(1.0, 2.0)  # as fast as it may be told, and more: from the moment that zero is told it runs on
    simulated.drive(0.1, forward(kind))
    told_ns = simulated.now_ns()
    simulated.drive(run_down_s(kind) + 0.5, (0.0, 0.0, 0.0))
    assert simulated.robot.state.cause is not None
    assert simulated.robot.state.cause.kind is causes.RUNAWAY
    assert (simulated.robot.state.last_stop.noticed_ns - told_ns) / 1e9 < run_down_s(kind) + 0.2


@every_reporter
def test_wheels_that_turn_while_motion_is_enabled_and_idle_disable_it_then_latch(kind: str) -> None:
    simulated = service(kind)
    simulated.enable()
    simulated.wait(1.0)
    simulated.board.events()
    begun_ns = simulated.now_ns()
    simulated.board.roll(pushed_rps=0.4)
    simulated.wait_for("motion to be disabled", lambda: not simulated.robot.state.enabled)
    assert AFTER_S <= (simulated.now_ns() - begun_ns) / 1e9 < AFTER_S + 2 * every_s(kind) + 0.2
    assert simulated.robot.state.estop is None
    (told,) = [event for event in events(simulated, "disabled") if "the wheels turn" in event.text]
    assert "although they were told zero for 1.5 s" in told.text
    assert any(frame.is_stop for frame in simulated.board.events())
    disabled_ns = simulated.now_ns()
    simulated.wait_for("the latch", lambda: simulated.robot.state.estop)
    assert simulated.robot.state.cause.kind is causes.UNSTILL
    assert AFTER_S - 0.1 <= (simulated.now_ns() - disabled_ns) / 1e9 < AFTER_S + 0.3


@every_reporter
def test_a_robot_that_is_pushed_while_motion_is_disabled_is_told_of_and_nothing_more(kind: str) -> None:
    simulated = service(kind)
    simulated.wait(3.0)
    simulated.board.events()
    simulated.board.roll(pushed_rps=0.4)
    simulated.wait(8.0)
    assert simulated.robot.state.estop is None
    (told,) = events(simulated, "wheels_turn")
    assert "somebody pushes the robot" in told.text
    assert events(simulated, "command") == []
    assert events(simulated, "stop") == []
    simulated.board.roll()
    simulated.wait(2.0)
    assert "still again" in events(simulated, "wheels_turn")[-1].text
    simulated.robot.enable()


@every_reporter
def test_after_a_latched_stop_that_was_seen_still_no_contactor_opens(kind: str) -> None:
    simulated = service(kind)
    drives(simulated, kind)
    simulated.robot.estop("enough")
    simulated.wait(4.0)
    stop = simulated.robot.state.last_stop
    assert stop.observed_s is not None
    simulated.board.roll(pushed_rps=0.4)
    simulated.wait(6.0)
    assert events(simulated, "unstill", "command") == []
    assert len(events(simulated, "wheels_turn")) == 1
    assert simulated.robot.state.cause.kind is causes.REQUESTED


BY_COUNTS = ("arduino", "ugv")
"""Boards that control the wheels' speeds by the counts that they report."""


@pytest.mark.claim("RUNAWAY-1")
@pytest.mark.parametrize("kind", BY_COUNTS)
def test_wheels_that_a_board_does_not_count_stop_the_robot_and_are_never_said_to_be_still(kind: str) -> None:
    """Such a board turns them at full power, and its counts stay as at rest."""
    simulated = service(kind)
    drives(simulated, kind)
    simulated.board.lie(0.0)
    fault_ns = simulated.now_ns()
    simulated.drive(3.0, forward(kind))
    cause = simulated.robot.state.cause
    assert cause is not None
    assert cause.kind is causes.UNCOUNTED
    assert cause.named()["told"] == pytest.approx(told_rps(kind), abs=0.01)
    assert (
        1.0 - every_s(kind) <= (simulated.robot.state.last_stop.noticed_ns - fault_ns) / 1e9 < 1.8 + 2 * every_s(kind)
    )
    simulated.wait(3.0)
    assert simulated.robot.state.last_stop.observed_s is None
    assert simulated.robot.state.turning.does == "unknown"
    assert "encoder" in simulated.printed("why")
    simulated.board.lie(1.0)
    simulated.board.roll(pushed_rps=0.4)
    simulated.wait(1.0)
    simulated.board.roll()
    simulated.wait(1.0)
    assert simulated.robot.state.turning.does == "still", "they are counted again"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in BY_COUNTS])
def test_a_wheel_that_stands_is_a_warning_and_no_stop(kind: str) -> None:
    simulated = service(kind)
    drives(simulated, kind)
    simulated.board.roll(0.0)
    simulated.drive(5.0, forward(kind))
    assert simulated.robot.state.estop is None
    (told,) = events(simulated, "wheel_stands")
    assert told.text.startswith(
        f"the left wheel does not turn although the command is {told_rps(kind):.2f} turns a second"
    )
    own_scale = board_of(kind, 0.08, 0.0).reports.own_scale
    assert own_scale == ("board.per_rps is far too small" in told.text), "where the scale would show, were it not zero"


@every_reporter
def test_reversals_ramps_and_rests_are_no_alarm(kind: str) -> None:
    simulated = service(kind)
    simulated.enable()
    ahead = forward(kind)[0]
    for vx, wz in ((ahead, 0.0), (-ahead, 0.0), (0.0, 0.5), (0.0, 0.0), (0.05, -0.5)):
        simulated.drive(2.0, (vx, 0.0, wz))
    simulated.wait(3.0)
    simulated.drive(1.0, forward(kind))
    assert simulated.robot.state.estop is None
    assert events(simulated, "wheel_stands", "wheels_turn") == []


def test_a_robot_whose_imu_alone_feels_something_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shaken by hand: the first board reports nothing of its wheels."""
    simulated = Simulated({**SETTINGS, "imu.calibration_s": 0.5}, imu_hz=110.0)
    simulated.enable()
    simulated.wait(3.0)
    imu = simulated.lab.board.model.imu
    sample = imu.sample
    monkeypatch.setattr(imu, "sample", lambda _wheels, t_ns: sample((3.0, 3.0, 3.0, 3.0), t_ns))
    simulated.wait(5.0)
    assert simulated.robot.state.enabled, "what an IMU feels disables nothing"
    simulated.robot.disable()
    simulated.wait(6.0)
    assert simulated.robot.state.estop is None
    (told,) = events(simulated, "wheels_turn")
    assert told.text.startswith("the robot moves, or is being moved")
    assert events(simulated, "command") == []


@pytest.mark.slow
@pytest.mark.timeout(amount(300, 3600))
@every_reporter
def test_no_drive_of_a_healthy_robot_is_taken_for_a_runaway(kind: str) -> None:
    """At random: ramps, reversals, sudden zeros, rests."""
    chance, simulated = Random(kind), service(kind)
    simulated.enable()
    until_ns = simulated.now_ns() + amount(30, 3600) * 1_000_000_000
    ahead = forward(kind)[0]
    while simulated.now_ns() < until_ns:
        vx, wz = chance.choice((-1.0, -0.3, 0.0, 0.5, 1.0)) * ahead, chance.choice((-0.5, 0.0, 0.0, 0.5))
        simulated.drive(chance.choice((0.1, 0.5, 2.0)), (vx, 0.0, wz))
        if chance.random() < 0.2:
            simulated.wait(chance.choice((0.5, 2.5)))
        assert simulated.robot.state.estop is None
        assert simulated.robot.state.enabled
    assert events(simulated, "wheel_stands", "wheels_turn") == []

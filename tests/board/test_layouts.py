"""Other layouts on a simulated machine, and a base that is steered: the board is the judge."""

from __future__ import annotations

import random
import struct
from math import atan, radians

import pytest

from failstop.board.checks import FrameError
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.board.rrc import framing
from failstop.board.rrc.framing import BUS_SERVO, MOTOR, PWM_SERVO
from failstop.board.rrc.steering import LONGEST_WAY_MS, STEER, TAKES_MS
from failstop.board.servos import SERVO_MOVE
from failstop.messages.box import WIRE_HEAD
from failstop.policy.kinematics import Chassis, from_settings
from failstop.policy.settings import Settings
from failstop_lab.sim.model import BoardModel, Frame
from tests.support.simulated import Simulated

PWM: dict[str, object] = {"wheels.layout": "ackermann"}
BUS: dict[str, object] = {**PWM, "steering.kind": "bus", "steering.servo": 9, "steering.centre": 500}
BUS |= {"steering.per_rad": 238.7, "steering.sign": 1}
BASE: Chassis = from_settings(Settings(PWM))
FAST_RPS = 5.0
LATER_NS = 20_000_000
of_each_servo = pytest.mark.parametrize("given", [PWM, BUS], ids=["PWM", "bus"])


def board_with(given: dict[str, object], **changed: object) -> Board:
    return board_of(*Settings({**given, **{f"steering.{key}": value for key, value in changed.items()}}).board())


def steers(event: Frame) -> bool:
    return (event.func, *event.data[:1]) in ((PWM_SERVO, STEER), (BUS_SERVO, SERVO_MOVE))


def pulses(event: Frame) -> int:
    assert event.data[-3] == (3 if event.func == PWM_SERVO else 9), "the servo that steers"
    return int.from_bytes(event.data[-2:], "little")


def test_three_omni_wheels_are_driven_and_named() -> None:
    simulated = Simulated({"wheels.layout": "omni3"})
    simulated.enable()
    simulated.drive(0.6, (0.1, 0.0, 0.0))
    assert simulated.board.wheels() == pytest.approx((-0.2757, 0.0, 0.2757, 0.0), abs=0.001), "LeKiwi's 1129 steps/s"
    wheels = simulated.robot.state.wheels_radps
    assert wheels.names == ("left", "rear", "right")
    assert (wheels.left, wheels.rear, wheels.right) == pytest.approx((-1.732, 0.0, 1.732), abs=0.001)
    assert "front" not in simulated.printed("status")
    with pytest.raises(AttributeError, match=r"no wheel 'front_left': this robot has left, rear, right"):
        _ = wheels.front_left
    stopped = simulated.kill("gate")
    assert (stopped.was_turning, stopped.motion_after, stopped.still_ns is not None) == (True, 0, True)


@of_each_servo
def test_a_steered_base_is_steered_as_it_drives_and_stays_so_behind_a_stop(given: dict[str, object]) -> None:
    simulated = Simulated(given)
    simulated.enable()
    simulated.drive(0.8, (0.2, 0.0, 0.5))
    events = simulated.board.events()
    angle = atan(0.17706 * 0.5 / 0.2)
    expected = round(1500 - 636.62 * angle if given is PWM else 500 + 238.7 * angle)
    assert pulses([event for event in events if steers(event)][-1]) == expected
    assert simulated.board.wheels() == pytest.approx((0.0, 0.588, 0.0, -0.910), abs=0.001)
    assert simulated.robot.state.body_vel == pytest.approx((0.2, 0.0, 0.5))
    simulated.drive(0.6, (0.0, 0.0, 1.0))
    assert simulated.robot.state.body_vel == (0.0, 0.0, 0.0), "it does not turn on the spot"
    simulated.drive(0.8, (0.2, 0.0, -0.5))
    stopped = simulated.kill("gate", 0.1)
    assert (stopped.was_turning, stopped.motion_after) == (True, 0)
    events = simulated.lab.board.model.executed(0)
    last = max(at for at, event in enumerate(events) if event.is_motion)
    assert [at for at, event in enumerate(events) if steers(event) and at > last] == [last + 1], (
        "its own, and none after"
    )


@of_each_servo
def test_what_steers_is_refused_as_motion_is(given: dict[str, object]) -> None:
    board, speeds = board_with(given), BASE.wheels_rps(0.2, 0.0, 0.5)
    frame = board.motor_speeds(speeds, FAST_RPS)
    assert board.check_motion(frame, FAST_RPS) == ""
    assert len(frame) <= WIRE_HEAD, "the black box keeps all of it"
    assert board.check_motion(board.stop, FAST_RPS) == ""
    assert board.check_motion(frame[:27], FAST_RPS) == "not a steering frame", "wheels that turn are steered"
    assert board.check_motion(frame, 0.1).endswith("limit 0.10")
    assert board.check_aux(frame[27:])
    for bit in range(8 * len(frame)):
        changed = bytearray(frame)
        changed[bit // 8] ^= 1 << bit % 8
        assert board.check_motion(bytes(changed), FAST_RPS)
    assert board_with(given, servo=2).check_motion(frame, FAST_RPS)
    narrow = board_with(given, most_deg=20.0)
    assert narrow.check_motion(frame, FAST_RPS).startswith("steering at")
    with pytest.raises(FrameError, match="steering angle"):
        narrow.motor_speeds(speeds, FAST_RPS)


@of_each_servo
def test_no_cut_of_a_steered_frame_moves_or_steers_anything_else_behind_a_stop(given: dict[str, object]) -> None:
    """At every cut, the burst behind it: the wheels stand, and the servo is where it was or where it was sent."""
    rng, board = random.Random(1), board_with(given)
    for _ in range(40):
        velocity = rng.uniform(-0.2, 0.2), 0.0, rng.uniform(-1.0, 1.0)
        frame = board.motor_speeds(BASE.wheels_rps(*velocity), FAST_RPS)
        whole = {pulses(event) for event in told(frame) if steers(event)}
        assert len(whole) == 1
        for cut in range(len(frame) + 1):
            events = told(frame[:cut] + board.burst)
            assert not any(events[-1].speeds)
            assert {pulses(event) for event in events if steers(event)} <= whole
            assert all(abs(rps) <= FAST_RPS for event in events if event.func == MOTOR for rps in event.speeds)


def test_a_steering_frame_is_refused_if_it_takes_another_time_or_its_cut_would_steer_elsewhere() -> None:
    board, refused = board_with(PWM), set()
    motor = board.motor_speeds(BASE.wheels_rps(0.2, 0.0, 0.0), FAST_RPS)[: len(board.stop)]
    for ms in range(TAKES_MS - 1, LONGEST_WAY_MS + 2):
        for angle in range(1300, 1700, 5):
            data = struct.pack("<BHBH", STEER, ms, 3, angle)
            frame = motor + framing.seal(PWM_SERVO, data)
            why = board.check_motion(frame, FAST_RPS)
            if not TAKES_MS <= ms <= LONGEST_WAY_MS:
                assert why == f"another servo's frame ({STEER} 3 {ms})"
                continue
            cuts = (told(frame[:cut] + board.burst) for cut in range(len(motor), len(frame)))
            elsewhere = any(event.func == PWM_SERVO and event.data != data for events in cuts for event in events)
            assert why.startswith("another angle if cut after") if elsewhere else why == ""
            refused |= {why}
    assert any(refused)


@of_each_servo
def test_a_steering_servo_gets_the_time_until_the_next_frame(given: dict[str, object]) -> None:
    frame = board_with(given).motor_speeds(BASE.wheels_rps(0.2, 0.0, 0.5), FAST_RPS)
    [times] = [event.data[1:3] for event in told(frame) if steers(event)]
    assert int.from_bytes(times, "little") == TAKES_MS


@of_each_servo
def test_nothing_follows_a_steering_frame(given: dict[str, object]) -> None:
    """Zeros leave its CRC right."""
    board = board_with(given)
    frame = board.motor_speeds(BASE.wheels_rps(0.2, 0.0, 0.5), FAST_RPS)
    assert board.check_motion(frame + b"\0", FAST_RPS)


def told(data: bytes) -> list[Frame]:
    """Frames that a board executes of these bytes."""
    model = BoardModel(0, imu_hz=0.0)
    model.receive(data, 0)
    model.advance(LATER_NS)
    return model.executed(0)


@of_each_servo
def test_the_largest_angle_is_reached_and_not_passed(given: dict[str, object]) -> None:
    board = board_with(given)
    for way in (1, -1):
        *_, angle = BASE.wheels_rps(0.1, 0.0, way * 9.0)
        assert abs(angle) == pytest.approx(radians(34))
        assert board.check_motion(board.motor_speeds(BASE.wheels_rps(0.1, 0.0, way * 9.0), FAST_RPS), FAST_RPS) == ""

"""Pings and their answers: that a ping can do no harm, that the board answers each, and what telemetry makes of it."""

from __future__ import annotations

import pytest

from failstop.board import framing
from failstop.board.decoder import Decoder, pong
from failstop.board.rrc.board import BOARD
from failstop.lab.sim import upward
from failstop.lab.sim.model import BoardModel
from failstop.lab.sim.receiver import Receiver
from failstop.messages import layout, records
from tests.support.stage import MS, Wire
from tests.support.telemetry_scene import S, Scene

STOP_DATA = BOARD.stop[4:-1]
DRIVE = BOARD.motor_speeds((0.796, 0.796, -0.796, -0.796), 2.0)
ALL = range(layout.PINGS)


def answer(index: int) -> tuple[int, bytes]:
    """The frame that answers a ping."""
    frame = upward.pwm_servo_position(index + 1, 1500)
    return frame[2], frame[4:-1]


# The pings.


def test_the_pings_differ_fill_the_layout_s_words_and_begin_with_the_published_one() -> None:
    assert len(BOARD.pings) == len(set(BOARD.pings)) == layout.PINGS
    assert BOARD.pings[0] == bytes.fromhex("AA5504020501E0")


@pytest.mark.parametrize("ping", BOARD.pings)
def test_a_ping_is_one_frame_that_is_no_motion_and_asks_for_a_servo_that_there_is(ping: bytes) -> None:
    assert BOARD.check_motion(ping, 1000.0) != ""
    assert framing.MOTOR_HEAD not in ping
    assert [found[1:] for found in Receiver().feed(ping)] == [(framing.PWM_SERVO, bytes((5, ping[5])))]
    assert ping[5] in (1, 2, 3, 4)


@pytest.mark.parametrize("behind", [BOARD.burst, BOARD.stop * 20, DRIVE * 20])
@pytest.mark.parametrize("ping", BOARD.pings)
def test_no_cut_of_a_ping_is_completed_to_anything(ping: bytes, behind: bytes) -> None:
    """Executed are frames that were written whole, and empty SYS frames of the burst's
    zeros, which do nothing. Nothing reads servo 0, which is outside the firmware's table."""
    whole = {(framing.SYS, b""), (framing.MOTOR, STOP_DATA), (framing.MOTOR, DRIVE[4:-1])}
    for cut in range(len(ping)):
        for version in (10, 11, 12):
            receiver = Receiver(version)
            receiver.feed(ping[:cut])
            executed = {(func, data) for _, func, data in receiver.feed(behind)}
            assert executed <= whole
            assert executed - {(framing.SYS, b"")}, "nothing came through"


@pytest.mark.parametrize(
    "frame",
    [
        upward.pwm_servo_position(0, 1500),
        upward.pwm_servo_position(5, 1500),
        upward.pwm_servo_deviation(1, 0),
        upward.bus_servo(1, 0x05, 500),
        upward.key_frame(1, 5),
        framing.frame(framing.PWM_SERVO, b"\x01\x05\xdc"),
        framing.frame(framing.PWM_SERVO, b""),
        BOARD.pings[1],
    ],
)
def test_other_frames_answer_none(frame: bytes) -> None:
    assert pong(frame[2], frame[4:-1]) is None


def test_the_board_answers_every_ping_in_order_with_no_servo_connected() -> None:
    board = BoardModel(0, imu_hz=0)
    board.receive(b"".join(BOARD.pings), 0)
    answers = Decoder().feed(b"".join(board.advance(S)))
    assert [pong(*frame) for frame in answers] == list(ALL)
    assert board.wheels == (0.0, 0.0, 0.0, 0.0)


# Telemetry.


def told(scene: Scene) -> tuple[int, int]:
    """The published (arrival_ns, index)."""
    return records.unpack_pong(scene.own.word("pong").get())


def test_an_answer_is_published_with_the_time_it_was_read_and_rings_the_supervisor(scene: Scene) -> None:
    assert told(scene) == (0, 0)
    for index in (0, 1, 2, 3, 0):
        scene.rung("supervisor_bell")
        scene.turn(answer(index), elapsed_ns=500 * MS)
        assert told(scene) == (scene.clock(), index)
        assert scene.rung("supervisor_bell")
    scene.turn((framing.PWM_SERVO, b"\x01\x09\x05"), (framing.PWM_SERVO, b"\x05\x05\xdc\x05"), elapsed_ns=MS)
    scene.turn((framing.BUS_SERVO, b"\x01\x05\x00\xdc\x05"), (framing.IMU_FUNC, bytes(24)))
    assert told(scene) == (scene.clock() - MS, 0), "nothing else counts as an answer"
    assert not scene.rung("supervisor_bell")
    frame = upward.pwm_servo_position(2, 1500)
    for piece in (frame[:5], frame[5:]):
        scene.wake(piece, elapsed_ns=10 * MS)
    assert told(scene) == (scene.clock(), 1), "an answer in pieces has the time of its last"


# A port that was opened again.


@pytest.mark.parametrize("reopened", [True, False])
def test_half_a_frame_from_before_a_reopening_does_not_join_what_comes_after(scene: Scene, reopened: bool) -> None:
    """Control: without a reopening the halves are one frame. So the frame is not made twice by luck."""
    frame = upward.pwm_servo_position(2, 1500)
    scene.wake(frame[:5])
    if reopened:
        scene.replug(2)
        scene.turn(elapsed_ns=3 * S)
    scene.wake(frame[5:])
    assert told(scene) == ((0, 0) if reopened else (scene.clock(), 1))


def test_bytes_of_the_lost_port_still_belong_together(scene: Scene) -> None:
    """The last of them, and the next port, are found in one turn."""
    whole, torn = upward.pwm_servo_position(2, 1500), upward.pwm_servo_position(3, 1500)
    scene.wake(whole[:5])
    following = Wire(scene.machine, 1)
    scene.send_port(following, 2)
    scene.wake(whole[5:] + torn[:5])
    assert told(scene) == (scene.clock(), 1)
    scene.wire = following
    scene.wake(torn[5:], elapsed_ns=MS)
    assert told(scene) == (scene.clock() - MS, 1)
    scene.turn(answer(3))
    assert told(scene) == (scene.clock(), 3)

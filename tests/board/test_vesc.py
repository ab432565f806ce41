"""VESCs: two motors in one write, one of them behind a CAN; a car with a steering servo. On the simulated machine."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from failstop.board.checks import FrameError
from failstop.board.kinds import board_of, wire_of
from failstop.board.vesc import codec
from failstop.board.wire import (
    SERVO_HEAT,
    SERVO_MISSING,
    SERVO_OTHER,
    Answer,
    Battery,
    Health,
    Restarted,
    Sample,
    Wheels,
)
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.supervisor.fit import slowest_mps
from failstop_lab.boards.vesc import DECIVOLTS, DEFAULT_LEAST_ERPM, Vesc, wrapped
from tests.support.simulated import Simulated

MS = 1_000_000
PAIR = codec.Motors((1,))
CAR: dict[str, object] = {
    "wheels.layout": "ackermann",
    "board.per_rps": 1450.0,
    "board.per_rps_confirmed": 1450.0,
    "limits.vx_mps": 1.0,
    "limits.wz_radps": 2.0,
}


def receiver(simulated: Simulated) -> Vesc:
    model: Any = simulated.lab.board.model
    found = model.receiver
    assert isinstance(found, Vesc)
    return found


def answer(which: int, can_id: int, steps: int, fault: int = 0, decivolts: int = DECIVOLTS, erpm: int = 0) -> bytes:
    """As a controller answers a question: 45 degrees, its motor 21."""
    mask = codec.MASKS[which].to_bytes(4, "big")
    heat = (450).to_bytes(2, "big") * bool(mask[3] & 1) + (210).to_bytes(2, "big") * bool(mask[3] & 2)
    values = (
        erpm.to_bytes(4, "big", signed=True)
        + decivolts.to_bytes(2, "big")
        + steps.to_bytes(4, "big", signed=True)
        + bytes((fault, can_id, 0))
    )
    return wrapped(bytes((codec.SELECTED,)) + mask + heat + values)


def kinds(samples: list[Sample]) -> list[str]:
    return [type(sample).__name__ for sample in samples]


def test_packets_are_the_ones_that_others_make() -> None:
    """CRC-16/XMODEM of the firmware; the vectors are pyvesc 1.0.5's."""
    assert codec.packet(b"\x06\0\0\0\0").hex() == "02050600000000cd8503"
    assert codec.VALUES.hex() == "020104408403"
    assert codec.Motors().frame((1234.9,), 2000.0).hex() == codec.packet(b"\x08\0\0\x04\xd2").hex()


@pytest.mark.parametrize("can_ids", [(), (1,), (2,), (3,), (253,)])
def test_every_id_has_frames_of_one_length_and_a_stop_that_is_the_frame_of_zeros(can_ids: tuple[int, ...]) -> None:
    motors = codec.Motors(can_ids)
    fastest = motors.frame((-codec.LIMIT,) * motors.wheels, codec.LIMIT)
    assert len(fastest) == len(motors.rest)
    assert motors.burst.startswith(motors.rest)
    assert len(motors.burst) * 4 > codec.PENDING
    assert motors.check(fastest, codec.LIMIT) == ""
    assert motors.check(fastest, codec.LIMIT - 1) != ""


def test_an_answer_counts_when_both_controllers_have_answered_the_same_question() -> None:
    reader = PAIR.replies()
    assert kinds(reader.feed(answer(0, 0, 10))) == ["Health"], "the first report of one that is there"
    found = reader.feed(answer(0, 1, -7, decivolts=120, erpm=-1000))
    assert kinds(found)[:3] == ["Wheels", "Battery", "Answer"]
    wheels, battery, text = found[:3]
    assert isinstance(wheels, Wheels)
    assert isinstance(battery, Battery)
    assert isinstance(text, Answer)
    assert (wheels.speeds, wheels.positions, battery.volts, text.text) == ((0.0, -1000.0), (10.0, -7.0), 11.8, "0")
    # One that answers another question, or without the controller at the port before it, proves nothing.
    assert not any(isinstance(each, Answer) for each in reader.feed(answer(0, 0, 11) + answer(1, 1, -7)))
    assert not any(isinstance(each, Answer) for each in reader.feed(answer(0, 1, -7)))
    assert any(isinstance(each, Answer) for each in reader.feed(answer(1, 0, 11) + answer(1, 1, -7)))


def test_the_second_controller_is_named_when_it_leaves_two_questions_unanswered() -> None:
    reader = PAIR.replies()
    reader.feed(answer(0, 0, 1) + answer(0, 1, 1))
    heard = [reader.feed(answer(turn % 2, 0, 1)) for turn in range(4)]
    named = [[sample.rows for sample in each if isinstance(sample, Health)] for each in heard]
    assert [bool(rows) for rows in named] == [False, False, True, False]
    assert (codec.BEHIND, 0.0, 0, SERVO_MISSING) in named[2][0]
    (back,) = [each for each in reader.feed(answer(0, 1, 1)) if isinstance(each, Health)]
    assert {row[0]: row[-1] for row in back.rows} == {codec.LOCAL: 0, codec.BEHIND: 0}


def test_a_controller_at_the_port_that_has_the_other_one_s_id_is_not_taken_for_both() -> None:
    """The answers are its own, so the second controller is the one that is missing."""
    reader = PAIR.replies()
    heard = [sample for turn in range(4) for sample in reader.feed(answer(turn, 1, 1))]
    assert kinds(heard) == ["Health"] * len(heard)
    wrong = [row for sample in heard if isinstance(sample, Health) for row in sample.rows if row[-1]]
    assert [(row[0], row[-1]) for row in wrong] == [(codec.BEHIND, SERVO_MISSING)]


def test_lost_answers_of_the_controller_at_the_port_do_not_make_the_other_one_missing() -> None:
    lost = bytearray(answer(0, 0, 1))
    lost[7] ^= 0x5A
    for reader, before in ((PAIR.replies(), bytes(lost)), (PAIR.replies(), b"")):
        if not before:
            reader.feed(answer(0, 0, 1) + answer(0, 1, 1))
        heard = [sample for _ in range(6) for sample in reader.feed(before + answer(0, 1, 1))]
        assert not any(row[-1] for sample in heard if isinstance(sample, Health) for row in sample.rows)


@pytest.mark.parametrize("at", range(len(answer(0, 1, 1))))
def test_an_answer_that_was_garbled_on_the_line_is_not_missing(at: int) -> None:
    """Noise on the line is no lost wheel. Once the line is quiet, a controller that answers nothing is missing."""
    reader = PAIR.replies()
    reader.feed(answer(0, 0, 1) + answer(0, 1, 1))
    garbled = bytearray(answer(0, 1, 1))
    garbled[at] ^= 0x5A
    heard = [sample for _ in range(20) for sample in reader.feed(answer(0, 0, 1) + bytes(garbled))]
    assert not any(bits for sample in heard if isinstance(sample, Health) for *_, bits in sample.rows)
    quiet = [sample for _ in range(20) for sample in reader.feed(answer(0, 0, 1))]
    assert any(bits for sample in quiet if isinstance(sample, Health) for *_, bits in sample.rows)


@pytest.mark.parametrize("which", range(len(codec.MASKS)))
def test_a_controller_s_fault_and_temperature_are_reported(which: int) -> None:
    reader = PAIR.replies()
    found = reader.feed(answer(which, 0, 1) + answer(which, 1, 1, fault=5))
    health = [sample for sample in found if isinstance(sample, Health)][-1]
    heat = 45 if codec.MASKS[which] & 1 else 0
    assert health.rows == ((codec.LOCAL, 0.0, heat, 0), (codec.BEHIND, 0.0, heat, SERVO_HEAT))
    assert not any(isinstance(sample, Answer) for sample in found)


@pytest.mark.parametrize(("fault", "answered"), [(0, True), (1, False), (2, True), (4, False), (255, False)])
@pytest.mark.parametrize("which", [0, 1])
def test_an_answer_amid_a_fault_is_no_sign_that_a_stop_was_executed(which: int, fault: int, answered: bool) -> None:
    """The controller drops commands for 0.5 s, and then drives on. Without a battery it has a fault all the time."""
    reader = codec.Motors((1,)).replies()
    reader.feed(answer(0, 0, 1) + answer(0, 1, 1))
    faults = {which: fault}
    heard = [
        reader.feed(answer(ask, 0, 1, fault=faults.get(0, 0)) + answer(ask, 1, 1, fault=faults.get(1, 0)))
        for ask in (1, 2, 3)
    ]
    assert [any(isinstance(sample, Answer) for sample in found) for found in heard] == [answered] * 3
    assert all(any(isinstance(sample, Wheels) for sample in found) for found in heard)
    told = [sample.text for found in heard for sample in found if isinstance(sample, Restarted)]
    assert told == ([f"controller {which + 1} released its motor (fault {fault})"] if fault else []), "once"
    over = reader.feed(answer(0, 0, 1) + answer(0, 1, 1))
    assert any(isinstance(sample, Answer) for sample in over)


@pytest.mark.parametrize("fault", [3, 7, 26, 255])
def test_a_fault_that_has_no_name_is_reported_too(fault: int) -> None:
    """A controller releases its motor at any fault, so a fault is not over when another one takes its place."""
    reader = PAIR.replies()
    heard = [reader.feed(answer(0, 0, 1) + answer(0, 1, 1, fault=code)) for code in (5, fault, 0)]
    bits = [sample.rows[-1][-1] for found in heard for sample in found if isinstance(sample, Health)]
    assert bits[-3:] == [SERVO_HEAT, SERVO_OTHER, 0]


def test_older_firmware_leaves_the_status_out() -> None:
    reader = codec.Motors().replies()
    assert kinds(reader.feed(wrapped(answer(0, 0, 5)[2:-4])))[:3] == ["Wheels", "Battery", "Answer"]


def test_answers_are_found_in_any_noise_and_in_any_pieces() -> None:
    rng = random.Random(3)
    whole = answer(0, 0, 5) + answer(0, 1, 6)
    for _ in range(60):
        reader, stream = PAIR.replies(), b"".join(rng.randbytes(rng.randrange(40)) + whole for _ in range(12))
        found, at = 0, 0
        while at < len(stream):
            size = rng.randrange(1, 30)
            found += sum(isinstance(each, Answer) for each in reader.feed(stream[at : at + size]))
            at += size
        assert found >= 6, "a head in the noise may take a few answers with it"


def test_a_stop_is_heard_by_both_motors_wherever_the_frame_before_it_was_cut() -> None:
    """Between the packets of two motors too: one has its new speed then, and the other one does not."""
    moved = set()
    for frame in (PAIR.frame((1000, -1000), codec.LIMIT), PAIR.frame((-4321, 99), codec.LIMIT)):
        for cut in range(len(frame) + 1):
            board = Vesc()
            for value in frame[:cut]:
                board.take(value, MS)
            moved.add(tuple(map(bool, board.wheels)))
            for value in PAIR.burst:
                board.take(value, 2 * MS)
            assert board.wheels == (0.0, 0.0), cut
    assert moved == {(False, False), (True, False), (True, True)}


def test_control_half_a_stop_leaves_the_second_motor_as_it_was() -> None:
    """Which is why another writer finishes it (test_stop_of_every_board.py)."""
    board = Vesc()
    for value in PAIR.frame((1000, -1000), codec.LIMIT) + PAIR.burst[: len(codec.Motors().rest)]:
        board.take(value, MS)
    assert board.wheels == (0.0, -1000.0)


def test_a_controller_brakes_below_its_least_speed() -> None:
    board = Vesc(least_erpm=DEFAULT_LEAST_ERPM)
    for value in PAIR.frame((899, 900), codec.LIMIT):
        board.take(value, MS)
    assert board.wheels == (0.0, 900.0)


def test_a_dead_can_holds_the_first_motor_s_stop_up_by_nothing() -> None:
    """Each packet for the CAN waits 5 ms there, behind the stop of the motor at the port."""
    board, now_ns = Vesc(), 0
    for value in PAIR.frame((1000, 1000), codec.LIMIT):
        now_ns += 87_000
        board.byte(now_ns, value)
    board.until(now_ns + MS)
    board.can_dead = True
    begun_ns = now_ns
    for value in PAIR.burst:
        now_ns += 87_000
        board.byte(now_ns, value)
    board.until(now_ns + 20 * MS)
    stopped_ns = next(at_ns for at_ns, speeds in board.commands if speeds[0] == 0.0)
    assert stopped_ns - begun_ns < 2 * MS
    assert board.wheels == (0.0, 1000.0)


# The whole service.


@pytest.fixture
def pair() -> Simulated:
    simulated = Simulated(kind="vesc")
    simulated.enable()
    return simulated


def test_a_motor_whose_can_breaks_stops_the_robot_and_is_named(pair: Simulated) -> None:
    pair.drive(0.6)
    board = receiver(pair)
    assert all(board.wheels)
    board.can_dead = True
    begun_ns = pair.lab.machine.now_ns
    pair.drive(1.0)
    first_ns = next(
        frame.executed_ns
        for frame in pair.board.events()
        if frame.executed_ns > begun_ns and frame.speeds and not frame.speeds[0]
    )
    assert first_ns - begun_ns < 300 * MS
    state = pair.robot.state
    assert state.cause.kind.name == "wheel_missing"
    assert "motor 2 (the VESC on its CAN)" in str(state.cause)
    assert pair.robot.state.last_stop.acknowledged_s is None
    pair.wait(1.3)
    assert not any(board.wheels), "the second motor, by its own timeout"
    board.can_dead = False
    pair.wait(0.5)
    pair.robot.reset()
    pair.enable()
    pair.drive(0.3)
    assert all(board.wheels)


@pytest.fixture
def car() -> Simulated:
    simulated = Simulated(CAR, kind="vesc")
    simulated.enable()
    return simulated


def test_a_car_steers_drives_and_keeps_its_angle_at_a_stop(car: Simulated) -> None:
    car.drive(1.0, (0.5, 0.0, 0.4))
    board = receiver(car)
    erpm, other = board.wheels
    assert other == 0.0
    assert erpm == pytest.approx(0.5 / (math.pi * 0.1) * 1450, rel=0.01)
    angle = math.atan(0.33 * 0.4 / 0.5)
    place = 1530 - 1000 - angle * 1213.5
    assert board.servo == pytest.approx(place, abs=1.5)
    assert car.robot.state.steering_rad == pytest.approx(angle, abs=0.01)
    car.robot.estop("enough")
    car.wait(0.3)
    assert board.wheels == (0.0, 0.0)
    assert board.servo == pytest.approx(place, abs=1.5)
    assert car.robot.state.last_stop.acknowledged_s is not None


def test_a_car_s_odometry_is_its_wheel_s_way_along_the_commanded_angle(car: Simulated) -> None:
    car.drive(3.0, (0.5, 0.0, 0.3))
    car.wait(1.0)
    found = car.robot.state.odometry
    assert found.source == "wheels"
    steps = receiver(car).motors[0].steps
    way_m = steps / 145.0 * math.pi * 0.1
    assert way_m > 0.8
    assert found.th_rad == pytest.approx(way_m * 0.6, rel=0.1), "0.3 rad/s at 0.5 m/s"
    assert math.hypot(found.x_m, found.y_m) == pytest.approx(2 / 0.6 * math.sin(0.6 * way_m / 2), rel=0.1)


def test_what_steers_is_checked_as_motion_is() -> None:
    board = board_of(*Settings({"board.kind": "vesc", **CAR}).board())
    frame = board.motor_speeds((1.0, 0.2), 2.0)
    assert board.check_motion(frame, 2.0) == ""
    assert board.check_motion(frame, 0.9) != ""
    assert board.check_motion(frame[:-1], 2.0) != ""
    assert board.check_motion(frame + frame, 2.0) != ""
    far = frame[: len(board.stop)] + codec.packet(b"\x0c" + (0).to_bytes(2, "big"))
    assert "steering at 1000," in board.check_motion(far, 2.0)
    assert board.motor_speeds((0.0, 0.2), 2.0) == board.stop
    with pytest.raises(FrameError, match="steering angle"):
        board.motor_speeds((1.0, 0.5), 2.0)


def test_settings_that_no_vesc_can_follow_are_refused_by_name() -> None:
    steered = {"board.kind": "vesc", "wheels.layout": "ackermann"}
    for changed, said in (
        ({"steering.kind": "bus"}, "steering.kind"),
        ({"steering.servo": 2}, "steering.servo = 2"),
        ({"steering.most_deg": 30.0}, "steering.most_deg"),
        ({"board.can_id": 5}, "board.can_id"),
        ({"wheels.id_2": 1}, "wheels.id_2"),
    ):
        with pytest.raises(SettingError, match=said):
            Settings({**steered, **changed})
    with pytest.raises(SettingError, match=r"board\.can_id"):
        Settings({"board.kind": "ugv", "board.can_id": 5})


def test_the_slowest_speed_of_a_car_is_by_its_own_scale() -> None:
    """`failstop config --check` prints it: one of a car's 1450 ERPM for a turn a second, not of a hub motor's 900."""
    car = Settings({"board.kind": "vesc", "wheels.layout": "ackermann"})
    assert slowest_mps(car) == pytest.approx(math.pi * 0.1 / 1450)


def test_the_id_on_the_can_is_the_settings() -> None:
    board = board_of(*Settings({"board.kind": "vesc", "board.can_id": 77}).board())
    assert board.stop == codec.Motors((77,)).rest
    assert wire_of("vesc").motion.rest != board.stop

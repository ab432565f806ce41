"""The simulated board's model: that it judges by the board's rules."""

from __future__ import annotations

import math
import statistics

import pytest

from failstop.board.rrc import codec, decoder, framing
from failstop.board.rrc.burst import BURST
from failstop_lab.sim import imu
from failstop_lab.sim.client import Event
from failstop_lab.sim.model import BoardModel, commands_stop
from tests.support import frames
from tests.support.amounts import amount

MS = 1_000_000
FORWARD = (0.796, 0.796, -0.796, -0.796)
FAST = (1.393, 1.393, -1.393, -1.393)
TURN = (-0.694, -0.694, -0.694, -0.694)
DRIVE = codec.motor_speeds(FORWARD, 2.0)


def quiet(battery_mv: int = 12_000) -> BoardModel:
    """A model without an IMU, at time 0."""
    return BoardModel(0, imu_hz=0, battery_mv=battery_mv)


def upward(model: BoardModel, until_ns: int, step_ns: int = 5 * MS) -> list[tuple[int, bytes]]:
    """Let time pass; return the frames the host would decode."""
    stream = decoder.Decoder()
    found: list[tuple[int, bytes]] = []
    for now_ns in range(0, until_ns + 1, step_ns):
        for frame in model.advance(now_ns):
            found += stream.feed(frame)
    return found


def test_a_wheel_keeps_its_last_speed_for_ever() -> None:
    model = quiet()
    model.receive(DRIVE, 0)
    for hours in range(1, 25):
        model.advance(hours * 3_600_000_000_000)
        assert model.wheels == pytest.approx(FORWARD)
    model.receive(frames.motor_stop_one(1), 24 * 3_600_000_000_000)
    model.advance(25 * 3_600_000_000_000)
    assert model.wheels == pytest.approx((0.796, 0.0, -0.796, -0.796))


def test_a_frame_takes_effect_when_its_last_byte_has_come_through() -> None:
    model = quiet()
    model.receive(DRIVE, 1000)
    model.advance(1000 + 27 * 10_000 - 1)
    assert model.wheels == (0.0, 0.0, 0.0, 0.0)
    assert model.executed(0) == []
    assert model.next_ns == model.settled_ns == 1000 + 27 * 10_000
    model.advance(1000 + 27 * 10_000)
    assert model.wheels == pytest.approx(FORWARD)
    (frame,) = model.executed(0)
    assert (frame.arrival_ns, frame.executed_ns) == (1000, 271_000)


def test_frames_queue_up_behind_each_other_on_the_wire() -> None:
    model = quiet()
    model.receive(DRIVE + codec.STOP, 0)
    model.receive(codec.STOP, 5_000)
    model.receive(codec.STOP, 10 * MS)
    model.advance(20 * MS)
    assert [frame.executed_ns for frame in model.executed(0)] == [270_000, 540_000, 810_000, 10 * MS + 270_000]
    assert [frame.arrival_ns for frame in model.executed(0)] == [0, 0, 5_000, 10 * MS]


def test_a_frame_in_pieces_arrives_with_its_last_piece() -> None:
    model = quiet()
    model.receive(DRIVE[:20], 0)
    model.receive(DRIVE[20:], 7 * MS)
    model.advance(20 * MS)
    (frame,) = model.executed(0)
    assert (frame.arrival_ns, frame.executed_ns) == (7 * MS, 7 * MS + 70_000)


def test_the_burst_as_the_board_sees_it() -> None:
    model = quiet()
    model.receive(DRIVE, 0)
    model.receive(BURST, MS)
    model.advance(20 * MS)
    frames = model.executed(1)
    assert [frame.executed_ns - MS for frame in frames] == [590_000, 3_430_000, 3_700_000, 3_970_000]
    assert all(commands_stop(frame.func, frame.data) for frame in frames)
    assert model.wheels == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("frame", "stops"),
    [
        (codec.STOP, True),
        (frames.motor_stop_mask(15), True),
        (frames.motor_stop_mask(7), False),
        (frames.motor_stop_one(0), False),
        (frames.motor_type(0), False),
        (DRIVE, False),
        (frames.PING, False),
    ],
)
def test_what_counts_as_a_stop(frame: bytes, stops: bool) -> None:
    model = quiet()
    model.receive(frame, 0)
    model.advance(MS)
    (executed,) = model.executed(0)
    assert commands_stop(executed.func, executed.data) is stops


def test_what_counts_as_motion() -> None:
    def event(frame: bytes, speeds: tuple[float, float, float, float]) -> Event:
        return Event(0, 0, 0, frame[2], frame[4:-1], speeds)

    assert event(DRIVE, FORWARD).is_motion
    assert event(frames.motor_stop_one(0), FORWARD).is_motion, "it leaves wheels turning"
    assert event(DRIVE, (math.nan, 0.0, 0.0, 0.0)).is_motion
    assert not event(codec.STOP, FORWARD).is_motion, "a stop that is refused is no motion command"
    assert not event(codec.motor_speeds((0.0, 0.0, 0.0, 0.0), 0.0), (0.0, 0.0, 0.0, 0.0)).is_motion
    assert not event(frames.PING, FORWARD).is_motion


def test_a_write_outside_the_motor_table_is_told() -> None:
    model = quiet()
    model.receive(bytes.fromhex("AA55030901D00701DC0502C40983") + DRIVE, 0)
    model.advance(MS)
    wild, tame = model.executed(0)
    assert wild.wild
    assert tame.wild == ()


def test_lost_bytes_took_their_time_on_the_wire() -> None:
    model = quiet()
    model.cut_bytes = 10
    model.receive(bytes(6), 0)
    model.receive(bytes(4) + DRIVE, 0)
    model.advance(MS)
    assert [frame.executed_ns for frame in model.executed(0)] == [370_000]


def test_ping_and_servo_reads_are_answered_after_execution() -> None:
    model = quiet()
    model.receive(DRIVE + frames.PING, 0)
    assert model.advance(340_000 + 90_000 - 1) == []
    assert model.advance(340_000 + 90_000) == [bytes.fromhex("AA5504040105DC0553")]
    model.receive(frames.pwm_servo_move(((1, 700), (3, 2200)), 0) + frames.pwm_servo_move_one(4, 900, 0), MS)
    model.receive(b"".join(codec.pwm_servo_read(servo) for servo in (1, 2, 3, 4)), MS)
    model.receive(frames.pwm_servo_deviation(2, -7) + frames.pwm_servo_read_deviation(2), MS)
    answers = [decoder.servo_reply(func, data) for func, data in upward(model, 100 * MS)]
    assert answers == [(1, 5, 700), (2, 5, 1500), (3, 5, 2200), (4, 5, 900), (2, 9, -7)]


def test_battery_every_second_and_a_step_in_three_readings() -> None:
    model = quiet(battery_mv=7400)
    assert [decoder.battery_mv(data) for _, data in upward(model, 2200 * MS)] == [7400, 7400]
    model.battery_mv = 7650
    assert [decoder.battery_mv(data) for _, data in upward(model, 6400 * MS)] == [7483, 7567, 7650, 7650]


def imu_samples(wheels: tuple[float, float, float, float], seed: int, seconds: int = 60) -> list[tuple[float, ...]]:
    """A settled robot's samples: acceleration in g, gyro in rad/s."""
    model = BoardModel(0, seed=seed)
    model.wheels = wheels
    samples = [decoder.imu(data) for func, data in upward(model, seconds * 1000 * MS) if func == framing.IMU_FUNC]
    return [(*s[:3], *map(math.radians, s[3:])) for s in samples[110:] if s is not None]


@pytest.mark.parametrize(
    ("wheels", "low", "high"),
    [
        ((0.0, 0.0, 0.0, 0.0), 0.0016, 0.0025),
        (FORWARD, 0.0050, 0.0060),
        ((-0.796, 0.796, -0.796, 0.796), 0.0050, 0.0060),
        (FAST, 0.0060, 0.0100),
        (TURN, 0.0040, 0.0060),
    ],
)
def test_gyro_noise_is_that_of_the_robot(wheels: tuple[float, float, float, float], low: float, high: float) -> None:
    for seed in range(amount(1, 3)):
        samples = imu_samples(wheels, seed)
        assert len(samples) == pytest.approx(59 * 110, abs=2)
        for axis in (3, 4):
            assert low <= statistics.stdev(sample[axis] for sample in samples) <= high


def test_the_imu_shows_gravity_rotation_and_bias() -> None:
    samples = imu_samples(TURN, 0)
    means = [statistics.mean(sample[axis] for sample in samples) for axis in range(6)]
    assert means == pytest.approx([0.0, 0.0, 1.0, 0.0, 0.0, 1.0], abs=0.005)
    model = BoardModel(0)
    model.imu.bias_rad_s = (0.01, -0.02, 0.03)
    gyros = [decoder.imu(data) or () for func, data in upward(model, 20_000 * MS) if func == framing.IMU_FUNC]
    assert [math.radians(statistics.mean(g[axis] for g in gyros)) for axis in (3, 4, 5)] == pytest.approx(
        [0.01, -0.02, 0.03], abs=0.001
    )


def test_shaking_dies_down_after_the_wheels_stop() -> None:
    sensor = imu.Imu(0, 0)
    for tick in range(200):
        sensor.sample(FAST, tick * 9 * MS)

    def spread(first: int) -> float:
        return statistics.stdev(sensor.sample((0.0,) * 4, (first + tick) * 9 * MS)[3] for tick in range(2000))

    shaking = statistics.stdev(sensor.sample((0.0,) * 4, (200 + tick) * 9 * MS)[3] for tick in range(5))
    assert math.degrees(0.0025) < shaking
    assert spread(300) < math.degrees(0.0025)


def test_two_runs_with_one_seed_are_the_same_and_with_another_are_not() -> None:
    def run(seed: int) -> list[tuple[int, bytes]]:
        model = BoardModel(0, seed=seed)
        model.garble_up = 0.01
        model.receive(DRIVE, 0)
        return upward(model, 3000 * MS)

    assert run(5) == run(5)
    assert run(5) != run(6)


def test_a_board_that_was_not_run_does_not_send_its_past() -> None:
    model = BoardModel(0)
    model.advance(1000 * MS)
    assert len(model.advance(60_000 * MS)) <= 15


def test_a_wild_speed_turns_the_imu_not_the_model() -> None:
    assert imu.shaking_mps((math.nan, math.inf, 0.0, 0.0)) > 0.5
    assert math.isfinite(imu.turn_rate_rad_s((1e30, -math.inf, math.nan, 0.0)))


def test_refused_stop_on_the_model() -> None:
    model = quiet()
    model.receive(DRIVE, 0)
    model.advance(MS)
    model.refuse_stop = True
    model.receive(codec.STOP + frames.motor_stop_one(2) + frames.motor_one(0, 0.5), MS)
    model.advance(10 * MS)
    assert model.wheels == pytest.approx((0.5, 0.796, -0.796, -0.796))
    model.refuse_stop = False
    model.receive(codec.STOP, 20 * MS)
    model.advance(30 * MS)
    assert model.wheels == (0.0, 0.0, 0.0, 0.0)

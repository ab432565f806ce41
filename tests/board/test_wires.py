"""The wires of other boards: vectors from the firmware's sources, the checks before the wire against the receivers,
readings, and the boards' own watchdogs."""

from __future__ import annotations

import random
from itertools import combinations_with_replacement
from math import floor, inf, nan, pi
from struct import Struct
from typing import Any

import pytest

from failstop.board.arduino import codec as arduino
from failstop.board.checks import FrameError
from failstop.board.described import Described
from failstop.board.hoverboard import codec as hoverboard
from failstop.board.hoverboard import feedback
from failstop.board.kinds import board_of, wire_of
from failstop.board.ugv import codec as ugv
from failstop.board.wire import Answer, Battery, Firmware, Imu, Motion, Obeyed, Sample, Wheels, Wire, beyond
from failstop.policy.kinematics import from_settings
from failstop.policy.settings import BAUDS, Settings
from failstop_lab.boards.arduino import Arduino
from failstop_lab.boards.line import arrivals, model_of, play
from tests.support.amounts import amount
from tests.support.boards import EVERY_KIND, wide

MS = 1_000_000
every_board = pytest.mark.parametrize("kind", EVERY_KIND)


def fields(samples: list[Sample]) -> list[tuple]:
    return [(type(sample), *vars(sample).values()) for sample in samples]


def test_frames_are_the_ones_that_the_firmware_s_own_algorithm_makes() -> None:
    assert bytes.fromhex("cdab00000000cdab") == hoverboard.STOP
    assert hoverboard.seal(0, 100) == bytes.fromhex("cdab00006400a9ab")
    assert hoverboard.seal(-50, 200) == bytes.fromhex("cdabceffc800cb54")
    assert arduino.MOTION.frame((100, -7), 999) == b"m +100, -7\r"
    assert ugv.MOTION.frame((0.2, -0.29), 2.0) == b'{"T":1,"L":20000e-5,"R":-29000e-5}\n'
    assert ugv.watchdog(500 * MS) == b'\n{"T":136,"cmd":500}\n'


@every_board
def test_every_board_keeps_what_the_vocabulary_promises(kind: str) -> None:
    wire = wire_of(kind)
    motion = wire.motion
    assert motion.rest == motion.frame(wide(0.0, -0.0, motion.wheels), 0.0)
    assert motion.check(motion.rest, 0.0) == ""
    assert all(row[0] == 0 and list(row) == sorted(set(row)) for row in wire.stop.repeats_ns)
    assert len(set(wire.stop.repeats_ns)) == len(wire.stop.repeats_ns) == 3
    for question in wire.questions:
        assert motion.check(question.ask, motion.limit)
    for bad in (nan, inf, -inf, motion.limit * 1.01):
        with pytest.raises(FrameError):
            motion.frame(wide(0.0, bad, motion.wheels), motion.limit)
    with pytest.raises(FrameError):
        motion.frame((0.0,), motion.limit)


def test_an_unknown_kind_of_board_is_refused() -> None:
    with pytest.raises(ValueError, match="it must be one of arduino, damiao, feetech, hoverboard, ugv, vesc"):
        wire_of("os")


def obeyed_of(kind: str, rng: random.Random, frame: bytes) -> list[tuple[float, ...]]:
    """Speeds that a receiver in any state is told, by a stop and then this frame twice."""
    wire, receiver = wire_of(kind), model_of(kind).any_state(rng)
    writes = [(0, wire.stop.writes[0].data), (13 * MS, frame), (25 * MS, frame)]
    play(receiver, arrivals(writes, wire.port.byte_ns), 42 * MS)
    return [speeds for _, speeds in receiver.commands]


@every_board
def test_speeds_are_sent_within_a_step_and_never_larger(kind: str) -> None:
    motion = wire_of(kind).motion
    rng = random.Random(kind)
    for _ in range(200):
        limit = motion.apart / 2
        speeds = tuple(rng.uniform(-limit, limit) for _ in range(motion.wheels))
        frame = motion.frame(speeds, limit)
        assert motion.check(frame, limit) == ""
        for sent, obeyed in zip(speeds, obeyed_of(kind, rng, frame)[-1], strict=True):
            assert abs(obeyed) <= abs(sent)
            assert abs(obeyed - sent) < 2 * motion.step


@every_board
def test_what_the_check_lets_through_moves_no_wheel_beyond_the_limit(kind: str) -> None:
    motion = wire_of(kind).motion
    rng = random.Random(kind)
    passed = 0
    for _ in range(amount(300, 20_000)):
        full = motion.apart / 2
        frame = bytearray(motion.frame([rng.uniform(-full, full) for _ in range(motion.wheels)], full))
        if rng.random() < 0.7:
            frame[rng.randrange(len(frame))] = rng.choice((0x30, 0x39, 0x2D, rng.randrange(256)))
        limit = full * rng.choice((0.3, 1.0))
        if motion.check(bytes(frame), limit):
            continue
        passed += 1
        assert all(abs(speed) <= limit for speeds in obeyed_of(kind, rng, bytes(frame)) for speed in speeds)
    assert passed > 5


LOSSES = {"arduino": (1, 2, 7, 12, 99, 100, 304, 999), "ugv": (0.001, 0.002, 0.009, 0.017, 0.1, 0.171, 0.2, 1.999, 2.0)}
"""Speeds whose lines lose bytes, in each board's unit: few digits fuse with their neighbours into the largest."""
INTO_THE_NEXT = 6
"""So many bytes of the line behind it may be lost too: digits of both could meet."""


@pytest.mark.parametrize("kind", LOSSES)
def test_two_lost_bytes_never_make_a_larger_speed(kind: str) -> None:
    """Lines have no check, so their form has to do: any one or two bytes, where another line follows."""
    motion = wire_of(kind).motion
    faster = tried = 0
    for speed in LOSSES[kind]:
        for speeds in ((speed, speed), (-speed, speed), (speed, -speed), (speed, 0.0)):
            line = motion.frame(speeds, motion.limit)
            for lost in combinations_with_replacement(range(len(line) + INTO_THE_NEXT), 2):
                receiver = model_of(kind).live()
                left = bytes(value for at, value in enumerate(line + line) if at not in lost)
                play(receiver, arrivals([(0, left)], wire_of(kind).port.byte_ns), 30 * MS)
                faster += any(abs(wheel) > speed for _, each in receiver.commands for wheel in each)
                tried += 1
    assert faster == 0
    assert tried > 4_000


@pytest.mark.parametrize("kind", [kind for kind in EVERY_KIND if wire_of(kind).watchdog.acts_ns])
def test_the_board_s_own_watchdog_stops_the_wheels_when_the_host_is_gone(kind: str) -> None:
    wire = wire_of(kind)
    full = wire.motion.apart / 2
    receiver = model_of(kind).any_state(random.Random(kind))
    arm_ns = wire.watchdog.after_ns
    driven = wire.motion.frame((full,) * wire.motion.wheels, full)
    writes = [(MS, driven), (12 * MS, driven)]
    if wire.watchdog.arm:
        arm_ns = 500 * MS
        writes.append((MS - 1, wire.watchdog.arm(arm_ns)))
    play(receiver, arrivals(writes, wire.port.byte_ns), 12 * MS + arm_ns - 20 * MS)
    assert any(receiver.wheels)
    receiver.until(20 * MS + arm_ns + 40 * MS)
    assert not any(receiver.wheels)


def test_glued_arduino_lines_never_fuse_into_a_larger_speed() -> None:
    """A line that was cut anywhere, and a whole one behind it: both carry signs, so atoi ends at the second."""
    for left, right, other in ((999, -999, 999), (12, 34, -12), (-7, 250, 99)):
        line, after = arduino.MOTION.frame((left, right), 999), arduino.MOTION.frame((other, other), 999)
        for end in range(len(line)):
            receiver = model_of("arduino").any_state(random.Random(0))
            play(receiver, arrivals([(0, line[:end] + after)], 175_000), 20 * MS)
            assert all(abs(speed) <= 999 for _, speeds in receiver.commands for speed in speeds)


@every_board
def test_a_reader_takes_any_pieces_and_any_bytes(kind: str) -> None:
    rng = random.Random(kind)
    wire, receiver = wire_of(kind), model_of(kind).live()
    asks = [(1 + at * 50 * MS, question.ask) for at, question in enumerate(wire.questions * 3)]
    play(receiver, arrivals(asks, wire.port.byte_ns), 400 * MS)
    said = b"".join(data for _, data in receiver.said)
    whole = fields(wire_of(kind).reader().feed(said))
    # Of a board that answers nothing and reports nothing there is nothing to read.
    assert len(whole) > 2 or not (said or wire.questions or wire.proofs)
    reader = wire_of(kind).reader()
    assert [each for value in said for each in fields(reader.feed(bytes((value,))))] == whole
    for _ in range(100):
        reader.feed(rng.randbytes(rng.randrange(200)))


def test_readings_are_the_same_few_samples_for_all() -> None:
    read = wire_of("hoverboard").reader().feed(b"\xcd" + feedback.seal(100, 200, -50, 40, 3650, 30))
    assert fields(read) == [(Obeyed, (250.0, 150.0)), (Wheels, (40.5, 49.5625), ()), (Battery, 36.5)]
    assert fields(wire_of("arduino").reader().feed(b"-12 7\r\nOK\r\n")) == [
        (Wheels, (), (-12.0, 7.0)),
        (Answer, "OK"),
    ]
    report = b'{"T":1001,"L":0.1,"R":0,"ax":0,"ay":0,"az":8192,"gx":0,"gy":0,"gz":1640,"odl":3,"odr":4,"v":1200}\r\n'
    wheels, imu, battery = wire_of("ugv").reader().feed(report)
    assert fields([wheels, battery]) == [(Wheels, (), (3.0, 4.0)), (Battery, 12.0)]
    assert isinstance(imu, Imu)
    assert imu.accel == pytest.approx((0, 0, 9.80665))
    assert imu.gyro == pytest.approx((0, 0, 100 * pi / 180))
    with_arm = report.replace(b'"v"', b'"ab":1,"v"')
    assert not any(isinstance(sample, Imu) for sample in wire_of("ugv").reader().feed(with_arm))


def test_hoverboard_feedback_of_either_length_is_read_whatever_comes_between() -> None:
    """In pieces, behind garbage and cut frames, and after a change from one to the other."""
    rng = random.Random("feedback")
    for _ in range(200):
        reader, stream, sent = wire_of("hoverboard").reader(), b"", []
        wide_one = rng.random() < 0.5
        counters = (rng.randrange(-9000, 9000), rng.randrange(-9000, 9000)) if wide_one else ()
        for number in range(8):
            words = [rng.randrange(-1000, 1000) for _ in range(4)]
            stream += feedback.seal(words[0], words[1], words[2], words[3], 3650, 30, counters=counters)
            sent.append(words)
            if number % 3 == 1 and rng.random() < 0.5:
                stream += feedback.seal(words[0], words[1], words[2], words[3], 3650, 30, counters=counters)[
                    : rng.randrange(18)
                ]
        found: list[Any] = []
        while stream:
            size = rng.randrange(1, 30)
            found += reader.feed(stream[:size])
            stream = stream[size:]
        found += reader.feed(bytes(24))
        assert [each.volts for each in found if isinstance(each, Battery)] == [36.5] * 8
        speeds = [each.speeds for each in found if isinstance(each, Wheels)]
        assert [tuple(map(floor, (left, -right))) for left, right in speeds] == [
            (left, right) for *_, right, left in sent
        ]
        assert sum(isinstance(each, Firmware) for each in found) == bool(counters)


def test_both_wheels_of_a_hoverboard_are_as_fast_on_a_straight_way() -> None:
    """Its firmware cuts to sixteenths of an rpm and rounds those down to whole ones; the right wheel goes backward."""
    read, rng = wire_of("hoverboard").reader(), random.Random(1)
    off = [0.0, 0.0]
    for _ in range(4000):
        sixteenths = int(16 * (rpm := rng.uniform(5.5, 60.0)))
        right, left = -sixteenths >> 4, sixteenths >> 4
        _, wheels, _ = read.feed(feedback.seal(0, 0, right, left, 3650, 30))
        assert isinstance(wheels, Wheels)
        off = [sum_rpm + speed - rpm for sum_rpm, speed in zip(off, wheels.speeds, strict=True)]
    assert [each / 4000 for each in off] == pytest.approx((0.0, 0.0), abs=0.03)
    _, still, _ = read.feed(feedback.seal(0, 0, 0, 0, 3650, 30))
    assert fields([still]) == [(Wheels, (0.0, 0.0), ())]


@pytest.mark.parametrize(
    ("kind", "answers"),
    [("arduino", [b"57600\r\n", b"1 2\r\n"]), ("ugv", [b'{"T":139,"L":1}\n', b'{"T":1002,"r":0}\n'])],
)
def test_a_question_knows_its_answer_from_the_others(kind: str, answers: list[bytes]) -> None:
    wire = wire_of(kind)
    samples = [wire.reader().feed(answer)[0] for answer in answers]
    for index, question in enumerate(wire.questions):
        assert [question.answered_by(sample) for sample in samples] == [index == at for at in range(len(samples))]


@pytest.mark.parametrize("baud", [baud for baud in BAUDS if baud])
def test_an_arduino_answers_with_the_rate_that_its_firmware_was_built_for(baud: int) -> None:
    receiver = model_of("arduino").live()
    assert isinstance(receiver, Arduino)
    receiver.baud = baud
    wire = wire_of("arduino")
    play(receiver, arrivals([(1, arduino.BAUD_RATE)], wire.port.byte_ns), 20 * MS)
    [answer] = wire.reader().feed(receiver.said[-1][1])
    assert [question.answered_by(answer) for question in wire.questions] == [True, False]


@every_board
def test_a_frame_tells_the_speeds_that_it_sets(kind: str) -> None:
    """Within a step, which an incident shows."""
    board, motion = board_of(kind, 0.08, 0.0), wire_of(kind).motion
    rng, per_rps = random.Random(kind), motion.per_rps(0.08)
    most = min(motion.apart / 2, motion.limit) / per_rps
    for _ in range(100):
        speeds = tuple(rng.uniform(-most, most) for _ in range(board.wheels))
        told = board.speeds(board.motor_speeds(speeds, most))
        assert told == pytest.approx(speeds, abs=2 * motion.step / per_rps)
    assert board.speeds(board.stop) == (0.0,) * board.wheels
    assert not any(board.speeds(ask) for ask in board.pings)


def test_a_wire_of_three_speeds_is_driven_in_its_own_unit() -> None:
    """LeKiwi's: 4096 steps a turn, and 1129 of them a second for 0.1 m/s."""
    steps = Struct("<3h")
    own = wire_of("arduino")
    motion = vars(own.motion) | {
        "wheels": 3,
        "limit": 3000.0,
        "apart": 6000.0,
        "frame": lambda speeds, _limit: steps.pack(*map(int, speeds)),
        "rest": bytes(6),
        "check": lambda frame, limit: beyond(steps.unpack(frame), limit, 3000.0),
        "speeds": steps.unpack,
    }
    board = Described(Wire(**(vars(own) | {"motion": Motion(**motion)})), 4096.0, 0.1)
    base = from_settings(Settings({"board.kind": "/own", "wheels.layout": "omni3"}))
    assert board.wheels == 3
    frame = board.motor_speeds(base.wheels_rps(0.1, 0.0, 0.0), board.most_rps)
    assert steps.unpack(frame) == (-1129, 0, 1129)
    assert board.speeds(frame) == pytest.approx((-1129 / 4096, 0.0, 1129 / 4096))
    assert board.motor_speeds(base.rest, 1.0) == board.stop
    assert (board.check_motion(frame, 0.3), board.check_motion(frame, 0.2)) == ("", "0 at -1129, limit 819.2")


def test_a_ugv_motion_line_that_lacks_only_its_line_feed_is_run_by_any_stop_and_for_less_than_3_ms() -> None:
    """No byte before the stop's line feed can spoil it: the firmware reads the first value of a line and ignores the
    rest. So the stop follows at once; every other cut does nothing."""
    wire = wire_of("ugv")
    line, byte_ns = wire.motion.frame((0.2, -0.2), 1.0), wire.port.byte_ns
    for spoil in (b"", *(bytes((value,)) for value in range(256)), b"}}", b'"x', b"\0\0", b'{"T":1}'):
        receiver = model_of("ugv").live()
        play(receiver, arrivals([(0, line[:-1] + spoil + ugv.STOP)], byte_ns), 20_000_000)
        moved, *stopped = receiver.commands
        assert moved[1] == (0.2, -0.2), spoil
        assert stopped[-1][1] == (0.0, 0.0)
        assert stopped[-1][0] - moved[0] < 3_000_000, spoil
    for end in range(len(line) - 1):
        receiver = model_of("ugv").live()
        play(receiver, arrivals([(0, line[:end] + ugv.STOP)], byte_ns), 20_000_000)
        assert [speeds for _, speeds in receiver.commands] == [(0.0, 0.0)]

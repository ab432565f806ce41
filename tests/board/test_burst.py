"""Proof of the stop burst: from every state of the board's receiver it is parsed and leaves the wheels at zero."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.rrc import codec, framing, servos
from failstop.board.rrc.burst import BURST, FIRST_STOP_END
from failstop.board.rrc.codec import STOP
from failstop.board.rrc.framing import MOTOR
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import CRC, DATA, FUNC, LEN, START1, START2, Receiver
from tests.support import frames
from tests.support.amounts import amount

VERSIONS = (10, 11, 12)
STOP_DATA = STOP[4:-1]
LAST_STOPS = (343, 370, 397)
SPINNING = (0.5, -0.25, 0.75, -1.0)
MAX_RPS = 2.0

# Every downward frame there is an encoder for, with speeds that are not zero and each longest where lengths differ.
OWN_FRAMES = {
    "speeds forward": codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS),
    "speeds turning": codec.motor_speeds((-0.694, -0.694, -0.694, -0.694), MAX_RPS),
    "speeds odd": codec.motor_speeds((1.0, -2.0, 0.1, 1e-3), MAX_RPS),
    "some": frames.motor_some([(1, -1.0), (2, 2.0)]),
    "some, four": frames.motor_some([(3, 1.5), (2, -1.5), (1, 0.3), (0, -0.3)]),
    "one": frames.motor_one(3, 1.25),
    "stop one": frames.motor_stop_one(2),
    "stop mask": frames.motor_stop_mask(0x0F),
    "stop": STOP,
    "pwm move": frames.pwm_servo_move([(1, 500), (2, 1500), (3, 2500), (4, 1000)], 1000),
    "pwm move one": frames.pwm_servo_move_one(1, 1000, 1000),
    "pwm read": frames.PING,
    "pwm deviation": frames.pwm_servo_deviation(4, -100),
    "pwm read deviation": frames.pwm_servo_read_deviation(1),
    "bus move": servos.bus_servo_move([(1, 501), (2, 502)], 40),
    "bus stop": servos.bus_servo_stop((1, 2, 3)),
    "bus position": servos.bus_servo_read(1, 0x05),
    "bus torque": servos.bus_servo_torque(1, on=True),
    "buzzer": codec.buzzer(1400, 100, 100, 5),
    "led": frames.led(1, 500, 300, 10),
    "oled": frames.oled(1, "x" * 23),
    "type": frames.motor_type(3),
    "rgb": frames.rgb([(0, 255, 1, 2), (1, 3, 4, 5)]),
    "alarm": frames.battery_alarm(6800),
}


def make(state: int, func: int = 0, length: int = 0, data: bytes = b"", version: int = 12) -> Receiver:
    receiver = Receiver(version)
    receiver.state, receiver.func, receiver.length, receiver.data = state, func, length, bytearray(data)
    return receiver


def execute(receiver: Receiver, motors: Motors, stream: bytes) -> list[tuple[int, bytes, tuple[float, ...]]]:
    """Feed a stream; return (bytes in, data, speeds after) of each motor command the board carries out."""
    return [(offset + 1, data, motors.execute(data)) for offset, func, data in receiver.feed(stream) if func == MOTOR]


def stop_ends(commands: list[tuple[int, bytes, tuple[float, ...]]]) -> list[int]:
    return [end for end, data, _ in commands if data == STOP_DATA]


def states_without_data(version: int) -> Iterator[Receiver]:
    yield from (make(state, version=version) for state in (START1, START2, FUNC))
    yield from (make(state, func, version=version) for func in range(version) for state in (LEN, CRC))


def assert_stopped(receiver: Receiver, first_end: int | None) -> None:
    motors = Motors(SPINNING)
    commands = execute(receiver, motors, BURST)
    ends = stop_ends(commands)
    assert motors.stopped
    assert commands[-1][1] == STOP_DATA
    assert tuple(ends[-3:]) == LAST_STOPS
    assert (ends[0] == FIRST_STOP_END) if first_end is None else (ends[0] == first_end)
    assert receiver.state == START1


def test_the_bytes_are_those_documented() -> None:
    assert bytes(32) + STOP + bytes(257) + STOP * 3 == BURST
    assert len(BURST) == 397
    assert FIRST_STOP_END == 59
    assert BURST[FIRST_STOP_END - len(STOP) : FIRST_STOP_END] == STOP


@pytest.mark.parametrize("version", VERSIONS)
def test_stops_in_every_state_with_every_remainder_of_every_function(version: int) -> None:
    for receiver in states_without_data(version):
        assert_stopped(receiver, None)
    for func in range(version):
        for remaining in range(1, 256):
            receiver = make(DATA, func, remaining, version=version)
            assert receiver.remaining == remaining
            assert_stopped(receiver, None if remaining <= 31 else LAST_STOPS[0])


@pytest.mark.slow
def test_stops_with_every_remainder_and_every_crc_so_far_of_a_motor_frame() -> None:
    # What a receiver in DATA does next depends on what is left and on the CRC of what it has; one byte that takes all
    # its values gives the CRC all of its own. Short: an eighth of them, others at each remainder; that of a frame whose
    # CRC comes out right is in the next test at every remainder.
    step = amount(8, 1)
    for remaining in range(255):
        for byte in range(remaining % step, 256, step):
            state = DATA if remaining else CRC
            receiver = make(state, MOTOR, remaining + 1, bytes((byte,)))
            assert_stopped(receiver, None if remaining <= 31 else LAST_STOPS[0])


def test_a_stray_frame_that_sets_speeds_comes_before_the_last_stops() -> None:
    # Two entries: wheel 0 at about 1 rps, and a wheel that is none with whatever the burst has next.
    prefix = bytearray.fromhex("0102000000803f09")
    for remaining in range(256 - len(prefix)):
        length = len(prefix) + remaining
        filler = BURST[: remaining + 1]
        # The lowest byte of the speed makes the CRC come out right.
        for byte in range(256):
            prefix[3] = byte
            if framing.crc8(bytes((MOTOR, length)) + prefix + filler) == 0:
                break
        motors = Motors()
        commands = execute(make(DATA if remaining else CRC, MOTOR, length, bytes(prefix)), motors, BURST)
        end, _, speeds = commands[0]
        assert end == remaining + 1
        assert speeds[0] == pytest.approx(1.0, abs=1e-3)
        assert motors.wild[0][0] == 9
        assert tuple(stop_ends(commands)[-3:]) == LAST_STOPS
        assert motors.stopped


def cuts(frame: bytes) -> Iterator[bytes]:
    return (frame[:cut] for cut in range(len(frame)))


@pytest.mark.parametrize("name", OWN_FRAMES)
def test_after_any_cut_of_an_own_frame_nothing_but_stops_is_executed(name: str) -> None:
    for part in cuts(OWN_FRAMES[name]):
        receiver, motors = Receiver(), Motors(SPINNING)
        receiver.feed(part)
        remaining = receiver.remaining if receiver.state == DATA else 0
        commands = execute(receiver, motors, BURST)
        # A cut stop that happens to be completed is a stop; everything else has to be STOP itself.
        assert all(speeds == (0.0, 0.0, 0.0, 0.0) for _, _, speeds in commands), part.hex()
        assert not motors.wild
        assert motors.kind == 0
        assert motors.stopped
        assert stop_ends(commands)[0] == (FIRST_STOP_END if remaining <= 31 else LAST_STOPS[0])


def unguarded(speeds: tuple[float, float, float, float]) -> bytes:
    """A frame as any other encoder makes it."""
    packed = struct.pack("<BfBfBfBf", 0, speeds[0], 1, speeds[1], 2, speeds[2], 3, speeds[3])
    body = bytes((MOTOR, 22, 1, 4)) + packed
    return framing.HEAD + body + bytes((framing.crc8(body),))


FORWARD = (0.796, 0.796, -0.796, -0.796)


def moved_by_cuts(frame: bytes) -> int:
    """How many cuts of a frame let the burst move a wheel before it stops them."""
    moved = 0
    for part in cuts(frame):
        receiver, motors = Receiver(), Motors()
        receiver.feed(part)
        commands = execute(receiver, motors, BURST)
        moved += any(any(speeds) for _, _, speeds in commands)
        assert not motors.wild
        assert motors.stopped
        assert stop_ends(commands)[0] == FIRST_STOP_END
    return moved


def test_control_zeros_complete_a_cut_frame_whose_crc_is_zero_there() -> None:
    """The robot's own forward speed, from an encoder that does not look."""
    assert moved_by_cuts(unguarded(FORWARD)) == 1
    assert moved_by_cuts(codec.motor_speeds(FORWARD, MAX_RPS)) == 0


@pytest.mark.slow
def test_after_any_cut_of_any_motor_frame_no_wheel_moves() -> None:
    coincidences = 0
    for hundredth in range(1, 141, amount(3, 1)):
        rps = hundredth / 100
        for sent in ((rps, rps, -rps, -rps), (-rps, rps, -rps, rps), (rps, -rps / 2, rps / 3, 0.0)):
            coincidences += moved_by_cuts(unguarded(sent)) > 0
            frame = codec.motor_speeds(sent, MAX_RPS)
            assert moved_by_cuts(frame) == 0
            assert struct.unpack("<xxxxxxBfBfBfBfx", frame)[1::2] == pytest.approx(sent, rel=1e-6)
    assert coincidences, "the test can fail"


@given(st.tuples(*[st.floats(-1.375, 1.375, width=32)] * 4))
def test_no_cut_of_a_moving_frame_has_a_crc_of_zero(speeds: tuple[float, float, float, float]) -> None:
    frame = codec.motor_speeds(speeds, 1.5)
    assert codec.check_motion(frame, 1.5) == ""
    for end in range(8, 27):
        assert framing.crc8(frame[2:end]) != 0 or not _moves(frame, end)


def _moves(frame: bytes, end: int) -> bool:
    """True when the frame up to `end`, filled up with zeros, sets any wheel to more than zero."""
    filled = frame[6:end].ljust(20, b"\0")[:20]
    return any(struct.unpack("<BfBfBfBf", filled)[1::2])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("wheel", range(4))
def test_a_speed_is_sent_smaller_by_no_more_than_its_cuts_need(wheel: int, sign: float) -> None:
    """Floats of one sign are in the order of their bits."""

    def speeds(bits: int) -> tuple[float, float, float, float]:
        (rps,) = struct.unpack("<f", struct.pack("<I", bits))
        a, b, c, d = (rps if at == wheel else 0.0 for at in range(4))
        return a, b, c, d

    def moves_if_cut(frame: bytes) -> bool:
        return any(framing.crc8(frame[2:end]) == 0 and _moves(frame, end) for end in range(8, 27))

    (first,) = struct.unpack("<I", struct.pack("<f", sign))
    smaller = 0
    for asked in range(first, first + 512):
        sent = next(bits for bits in range(asked, 0, -1) if not moves_if_cut(unguarded(speeds(bits))))
        assert codec.motor_speeds(speeds(asked), MAX_RPS) == unguarded(speeds(sent))
        smaller += sent != asked
    assert smaller, "the test can fail"


def test_a_burst_after_any_cut_of_one_or_with_a_byte_garbled_or_lost_still_stops() -> None:
    streams = [part + BURST for part in cuts(BURST)]
    flips = [*(1 << n for n in range(8)), 255]
    for at, byte in enumerate(BURST):
        garbled = [b"", *(bytes((byte ^ flip,)) for flip in flips), b"\xaa", b"\x55", b"\xff"]
        streams += [BURST[:at] + one + BURST[at + 1 :] for one in garbled]
    for number, stream in enumerate(streams):
        receiver, motors = Receiver(), Motors(SPINNING)
        ends = stop_ends(execute(receiver, motors, stream))
        assert number >= len(BURST) or number + FIRST_STOP_END in ends
        assert (bool(ends), motors.stopped, motors.wild) == (True, True, [])


def unstopped(stream: bytes) -> list[Receiver]:
    states = [*states_without_data(12), *(make(DATA, MOTOR, remaining) for remaining in range(1, 256))]
    return [state for state in states if not stop_ends(execute(state.copy(), Motors(SPINNING), stream))]


def test_control_two_bare_stops_or_no_long_filler_leave_states_unstopped() -> None:
    assert {state.state for state in unstopped(STOP + STOP)} == {LEN, DATA}
    assert unstopped(bytes(32) + STOP * 4)
    assert not unstopped(BURST)


def made(zeros: int = 32, first: int = 1, filler: int = 257, last: int = 3) -> tuple[bytes, bytes, bytes]:
    """A burst with so much of each part: what comes before the filler, the filler, the last stops."""
    return bytes(zeros) + STOP * first, bytes(filler), STOP * last


def stops_a_cut_motor_frame_at_once(burst: bytes) -> bool:
    """Within 0.6 ms, wherever the frame was cut."""
    for part in (*cuts(OWN_FRAMES["speeds forward"]), *cuts(OWN_FRAMES["some, four"])):
        receiver = Receiver()
        receiver.feed(part)
        if not stop_ends(execute(receiver, Motors(SPINNING), burst[:60])):
            return False
    return True


def outlasts_a_frame_that_begins_before_it(filler: bytes, stops: bytes) -> bool:
    """Though one of the filler's bytes is lost, every stop after it is parsed."""
    parsed = stop_ends(execute(make(DATA, MOTOR, 255), Motors(SPINNING), filler[1:] + stops))
    return len(parsed) == len(stops) // len(STOP)


def stops_though_a_byte_of_a_late_stop_is_lost(before: bytes, stops: bytes) -> bool:
    """The stop that has lost one takes the first byte of the next for its own last."""
    return not any(unstopped(before + stops[:at] + stops[at + 1 :]) for at in range(len(STOP)))


@pytest.mark.parametrize(("part", "least"), [("zeros", 23), ("first", 1), ("filler", 257), ("last", 3)])
def test_each_part_of_the_burst_is_needed(part: str, least: int) -> None:
    def works(size: int) -> bool:
        before, filler, stops = made(**{part: size})
        return (
            stops_a_cut_motor_frame_at_once(before + filler + stops)
            and outlasts_a_frame_that_begins_before_it(filler, stops)
            and stops_though_a_byte_of_a_late_stop_is_lost(before + filler, stops)
        )

    assert b"".join(made()) == BURST
    assert works(least)
    assert not works(least - 1)


def test_control_stop_frames_as_filler_can_write_to_a_wheel_that_is_none() -> None:
    wild: list[int] = []
    for hundredth in range(1, 141):
        for part in cuts(codec.motor_speeds((hundredth / 100,) * 4, MAX_RPS)):
            for stream in (STOP * 11, BURST):
                receiver, motors = Receiver(), Motors()
                receiver.feed(part)
                execute(receiver, motors, stream)
                wild += [wheel for wheel, _ in motors.wild]
                assert stream != BURST or not motors.wild
    assert min(wild) >= framing.WHEELS


def stops_needed(receiver: Receiver) -> int:
    """How many stop frames in a row it takes until one is parsed."""
    end = stop_ends(execute(receiver, Motors(SPINNING), STOP * 12))[0]
    assert end % len(STOP) == 0
    return end // len(STOP)


def test_stop_frames_needed_until_one_is_parsed() -> None:
    assert stops_needed(make(START1)) == 1
    assert {stops_needed(make(state)) for state in (START2, FUNC, CRC)} == {2}
    assert {stops_needed(make(DATA, MOTOR, left)) for left in range(1, 23)} == {2}
    assert stops_needed(make(LEN, MOTOR)) == 8
    by_remainder = [stops_needed(make(DATA, MOTOR, left)) for left in range(1, 256)]
    assert by_remainder[-1] == 11
    assert max(by_remainder) == 11
    assert all(fewer <= more for fewer, more in pairwise(by_remainder))

"""A frame that was cut, and the zeros of a stop burst: they make nothing of it, for every frame that is written, at
every cut.

Where a frame is cut decides by its CRC so far: at 0 the zeros go on with it and are its end. That is looked for here
with the CRC alone, so that many frames can be tried; test_burst.py, test_servos.py and the last tests here feed the
burst to the board's receiver.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from itertools import permutations, product
from random import Random
from struct import pack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from failstop.board.checks import FrameError
from failstop.board.rrc import codec, servos
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.board.rrc.codec import STOP, buzzer, check_aux
from failstop.board.rrc.framing import BUS_SERVO, BUZZER, MOTOR, SYS, crc8, seal
from failstop.board.servos import HIGHEST_ID, LONGEST_MOVE_MS, READS, SERVO_STOP
from failstop.procs.telemetry import pad
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver
from tests.support.amounts import amount

FRAMES = amount(20_000, 2_000_000)
PINGS = list(BOARD.pings)
QUESTIONS = [servos.bus_servo_read(servo, what) for servo in range(1, HIGHEST_ID + 1) for what in READS]
TORQUES = [servos.bus_servo_torque(servo, on) for servo in range(1, HIGHEST_ID + 1) for on in (True, False)]
SOUNDS = [BOARD.buzzer(*sound) for sound in (pad.LATCH_SOUND, pad.TUCK_SOUND, *pad.MODE_SOUNDS)]
U16 = (1, 2, 255, 256, 0xAA55, 0x55AA, 65_534, 65_535)


def completed(frame: bytes) -> list[bytes]:
    """The data of each frame that zeros make of a cut of this one, where it is another."""
    size = frame[3]
    found = [frame[4:cut].ljust(size, b"\0") for cut in range(4, 4 + size) if not crc8(frame[2:cut])]
    return [data for data in found if data != frame[4:-1]]


def test_it_is_what_the_board_s_receiver_makes_of_it() -> None:
    for tone in range(20, 20_000):
        frame = seal(BUZZER, pack("<4H", tone, 500, 100, 3))
        if made := completed(frame):
            break
    streams = [frame[:end] + bytes(32) for end in range(4, len(frame) - 1)]
    assert [data for stream in streams for _, func, data in Receiver().feed(stream) if func == BUZZER] == made
    assert codec.check_aux(frame).startswith("another sound if cut after ")
    assert codec.buzzer(tone, 500, 100, 3) == seal(BUZZER, pack("<4H", tone - 1, 500, 100, 3))


@pytest.mark.parametrize("asked", [20, 21, 22, 27, 28, 255, 256, 19_999, 20_000])
def test_a_tone_is_sent_as_near_as_its_cuts_let_it_and_a_lower_one_first(asked: int) -> None:
    near = [tone for tone in (*range(asked, asked - 9, -1), *range(asked + 1, asked + 9)) if 20 <= tone <= 20_000]
    others = 0
    for on_ms in range(1, 600):
        made = (seal(BUZZER, pack("<4H", tone, on_ms, 300, 773)) for tone in near)
        tone, frame = next((tone, each) for tone, each in zip(near, made, strict=False) if not completed(each))
        assert codec.buzzer(asked, on_ms, 300, 773) == frame
        others += tone != asked
    assert others, "the test can fail"


@pytest.mark.parametrize("cut", range(1, 8))
def test_a_sound_is_changed_for_any_one_of_its_cuts(cut: int) -> None:
    def completed_at(tone: int) -> bool:
        return crc8(seal(BUZZER, pack("<4H", tone, 100, 100, 773))[2 : 4 + cut]) == 0

    tone = next(tone for tone in range(300, 20_001) if completed_at(tone))
    assert check_aux(seal(BUZZER, pack("<4H", tone, 100, 100, 773))) != ""
    assert codec.buzzer(tone, 100, 100, 773)[4:6] != pack("<H", tone)


def sounds() -> Iterator[bytes]:
    random = Random("sounds")

    def u16() -> int:
        return random.randint(1, 65_535)

    values = [*product((20, 21, 0x55AA % 20_000, 19_999, 20_000), U16, U16, U16)]
    values += [(random.randint(20, 20_000), u16(), u16(), u16()) for _ in range(FRAMES)]
    for freq_hz, on_ms, off_ms, repeat in values:
        with contextlib.suppress(FrameError):  # what would put the start of a motor frame on the wire
            yield codec.buzzer(freq_hz, on_ms, off_ms, repeat)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_sound_goes_on_for_ever() -> None:
    tuned = 0
    for frame in sounds():
        assert completed(frame) == [], frame.hex()
        assert codec.check_aux(frame) == ""
        tuned += 1
    assert tuned > FRAMES


@pytest.mark.parametrize("frame", [*PINGS, *SOUNDS], ids=bytes.hex)
def test_pings_and_the_sounds_that_are_made(frame: bytes) -> None:
    assert completed(frame) == []


def test_questions_and_torques_of_every_servo() -> None:
    assert not [frame.hex() for frame in (*QUESTIONS, *TORQUES) if completed(frame)]


@pytest.mark.slow
@pytest.mark.parametrize("duration_ms", [1, 40, 60])
def test_no_move_of_one_servo_is_another_move(duration_ms: int) -> None:
    for servo, position in product(range(1, 11), range(servos.HIGHEST_POSITION + 1)):
        moves(servos.bus_servo_move([(servo, position)], duration_ms))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_move_of_two_servos_is_another_move_or_one_of_a_servo_0() -> None:
    random = Random("moves")
    for _ in range(FRAMES):
        pair = [(servo, random.randint(0, 1000)) for servo in random.sample(range(1, 254), 2)]
        with contextlib.suppress(FrameError):  # as above: of a servo 170
            moves(servos.bus_servo_move(pair, random.randint(1, 60)))


def moves(frame: bytes) -> None:
    """Cut before its first servo it may be a move of none."""
    assert not [data.hex() for data in completed(frame) if data[3]], frame.hex()


def test_a_cut_stop_stops_some_of_its_servos_and_a_servo_0() -> None:
    """No encoder can mend that, as a stop has nothing to vary. Nothing moves by it, and the next burst stops all."""
    found = 0
    for ids in permutations(range(1, 11), 3):
        frame = servos.bus_servo_stop(ids)
        for data in completed(frame):
            assert data[0] == SERVO_STOP
            assert set(data[2:]) <= {*ids, 0}
            found += 1
    assert found


def test_a_stop_may_be_written_though_zeros_complete_a_cut_of_it() -> None:
    pairs = permutations(range(2, HIGHEST_ID + 1), 2)
    ids = (*next(pair for pair in pairs if not crc8((BUS_SERVO, 5, SERVO_STOP, 3, *pair))), 1)
    frame = servos.bus_servo_stop(ids)
    assert completed(frame)
    assert servos.check_bus(frame, ids, LONGEST_MOVE_MS) == ""


VERSIONS = (10, 11, 12)
STOP_DATA = STOP[4:-1]
SPINNING = (0.5, -0.25, 0.75, -1.0)
REST = (0.0, 0.0, 0.0, 0.0)


def judge(stream: bytes, sound: bytes, version: int = 12) -> None:
    """The last motor command that the board executes is a stop, no wheel has got another speed, no handler ran whose
    lists could lead it outside its tables, where the wheels' set points are too, and no other sound was made."""
    receiver, motors = Receiver(version), Motors(SPINNING)
    last = b""
    for _, func, data in receiver.feed(stream):
        if func == MOTOR:
            last = data
            assert motors.execute(data) == REST, stream.hex()
        else:
            assert func == SYS or (func, data) == (BUZZER, sound), stream.hex()
    assert last == STOP_DATA
    assert motors.stopped
    assert not motors.wild
    assert motors.kind == 0


class MotorHeadInside(Exception):
    """Values that the encoder refuses, since they put the start of a motor frame on the wire."""


def sound(freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Raises MotorHeadInside; values in range are refused for nothing else."""
    try:
        return buzzer(freq_hz, on_ms, off_ms, repeat)
    except FrameError as error:
        if "aa5503" not in str(error):
            raise
        raise MotorHeadInside from None


def cut_anywhere(frame: bytes, versions: Sequence[int] = VERSIONS) -> None:
    for version in versions:
        for cut in range(len(frame) + 1):
            judge(frame[:cut] + BURST, frame[4:-1], version)


TIME = st.integers(1, 65_535)


@pytest.mark.slow
@given(freq_hz=st.integers(20, 20_000), on_ms=TIME, off_ms=TIME, repeat=TIME, data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_frame_that_can_be_encoded_cut_anywhere(
    freq_hz: int, on_ms: int, off_ms: int, repeat: int, data: st.DataObject
) -> None:
    try:
        frame = sound(freq_hz, on_ms, off_ms, repeat)
    except MotorHeadInside:
        return
    assert check_aux(frame) == ""
    cut_anywhere(frame)
    # And the burst cut too, and written again: its rest first, or a whole one.
    first, second = data.draw(st.integers(0, len(frame))), data.draw(st.integers(0, len(BURST)))
    judge(frame[:first] + BURST[:second] + BURST, frame[4:-1])
    judge(frame[:first] + BURST + BURST, frame[4:-1])
    judge(frame + frame[:first] + BURST, frame[4:-1])


@pytest.mark.slow
@given(data=st.binary(min_size=8, max_size=8))
@settings(max_examples=300, deadline=None)
def test_whatever_passes_the_check_may_be_cut_anywhere(data: bytes) -> None:
    frame = seal(BUZZER, data)
    if check_aux(frame) == "":
        cut_anywhere(frame, (12,))

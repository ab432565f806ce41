"""The models of the board's receiver and motor handler, against a literal reading of the firmware."""

from __future__ import annotations

import json
import math
from itertools import pairwise, permutations, product
from pathlib import Path
from struct import pack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.rrc import codec, framing
from failstop.board.rrc.framing import seal
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import CRC, DATA, FUNC, LEN, START1, START2, Receiver
from tests.support import frames

VECTORS = json.loads(Path(__file__).with_name("vectors.json").read_text())
FRAME = bytes.fromhex(VECTORS["down"]["motors 0..3 at 0.5, -0.25, 0, 1.5 rps"])


class Literal:
    """The firmware's state machine, one byte at a time, with its CRC bit by bit."""

    def __init__(self, first_invalid_func: int) -> None:
        self.first_invalid_func = first_invalid_func
        self.state = START1
        self.func = 0
        self.length = 0
        self.data: list[int] = []
        self.crc_errors = 0

    def feed(self, chunk: bytes) -> list[tuple[int, int, bytes]]:
        return [(at, self.func, bytes(self.data)) for at, byte in enumerate(chunk) if self.take(byte)]

    def take(self, byte: int) -> bool:
        if self.state == START1:
            if byte == 0xAA:
                self.state = START2
        elif self.state == START2:
            self.state = FUNC if byte == 0x55 else START1
        elif self.state == FUNC:
            self.state = START1
            self.func = byte
            if byte < self.first_invalid_func:
                self.state = LEN
        elif self.state == LEN:
            self.length = byte
            self.data = []
            self.state = CRC if byte == 0 else DATA
        elif self.state == DATA:
            self.data.append(byte)
            if len(self.data) == self.length:
                self.state = CRC
        else:
            self.state = START1
            if self.crc() == byte:
                return True
            self.crc_errors += 1
        return False

    def crc(self) -> int:
        crc = 0
        for byte in (self.func, self.length, *self.data):
            crc ^= byte
            for _ in range(8):
                crc = crc >> 1 ^ (0x8C if crc & 1 else 0)
        return crc


def compare(chunks: list[bytes], version: int = 12) -> None:
    fast, slow = Receiver(version), Literal(version)
    for chunk in chunks:
        assert fast.feed(chunk) == slow.feed(chunk)
        assert fast.state == slow.state
        assert fast.crc_errors == slow.crc_errors
        if fast.state in (LEN, DATA, CRC):
            assert fast.func == slow.func
        if fast.state in (DATA, CRC):
            assert (fast.length, list(fast.data)) == (slow.length, slow.data)
        if fast.state == DATA:
            assert fast.remaining == slow.length - len(slow.data)


# Bytes that matter to the receiver come up far more often than they would by chance.
wire_bytes = st.lists(
    st.one_of(
        st.binary(max_size=12),
        st.sampled_from(
            [b"\xaa", b"\xaa\x55", b"\xaa\xaa\x55", b"\xaa\x55\x03", b"\xaa\x55\x00\x00\x00", FRAME, codec.STOP]
        ),
        st.builds(lambda cut: FRAME[:cut], st.integers(0, len(FRAME))),
        st.builds(seal, st.integers(0, 12), st.binary(max_size=255)),
    ),
    max_size=12,
).map(b"".join)


@given(stream=wire_bytes, version=st.sampled_from((10, 11, 12)), cuts=st.lists(st.integers(0, 400), max_size=8))
def test_equals_the_literal_machine_on_any_bytes_in_any_pieces(stream: bytes, version: int, cuts: list[int]) -> None:
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    compare([stream[start:end] for start, end in pairwise(edges)], version)
    compare([bytes((byte,)) for byte in stream], version)


def test_equals_the_literal_machine_on_all_short_adversarial_strings() -> None:
    # With 00 the empty SYS frame is among them, and with it an accepted frame between heads and cut frames.
    alphabet = (0xAA, 0x55, 0x00, 0x01, 0x0C)
    accepted = 0
    for tail in product(alphabet, repeat=5):
        stream = b"\xaa\x55" + bytes(tail)
        compare([stream, codec.STOP])
        accepted += len(Receiver().feed(stream))
    assert accepted > 0


@pytest.mark.parametrize("name", VECTORS["refuse"])
def test_of_published_frames_the_board_drops_the_one_with_a_bad_crc_alone(name: str) -> None:
    taken = [] if "CRC" in name else [framing.MOTOR]
    assert [func for _, func, _ in Receiver().feed(bytes.fromhex(VECTORS["refuse"][name]))] == taken


def test_a_copy_goes_its_own_way() -> None:
    receiver = Receiver(11)
    receiver.feed(FRAME[:10])
    other = receiver.copy()
    assert other.feed(FRAME[10:]) == [(16, framing.MOTOR, FRAME[4:-1])]
    assert (receiver.state, receiver.remaining, receiver.frames) == (DATA, 16, 0)
    assert (other.state, other.frames, other.first_invalid_func) == (START1, 1, 11)
    motors = Motors((0.1, 0.2, 0.3, 0.4))
    copied = motors.copy()
    for command in (codec.STOP[4:-1], b"\x02\x09"):
        copied.execute(command)
    assert (motors.speeds_rps, motors.wild, copied.stopped) == ([0.1, 0.2, 0.3, 0.4], [], True)


def test_motors_take_every_command() -> None:
    motors = Motors()
    for frame, speeds in (
        (FRAME, (0.5, -0.25, 0.0, 1.5)),
        (frames.motor_one(2, 1.0), (0.5, -0.25, 1.0, 1.5)),
        (frames.motor_stop_one(0), (0.0, -0.25, 1.0, 1.5)),
        (frames.motor_stop_mask(0b1010), (0.0, 0.0, 1.0, 0.0)),
        (frames.motor_type(2), (0.0, 0.0, 1.0, 0.0)),
        (codec.STOP, (0.0, 0.0, 0.0, 0.0)),
    ):
        assert motors.execute(frame[4:-1]) == speeds
    assert (motors.kind, motors.wild) == (2, [])
    for kind, taken in ((3, 3), (4, 0)):
        motors.execute(bytes((5, kind)))
        assert motors.kind == taken, "a type out of range becomes the first"


def test_motors_are_stopped_when_all_four_are_zero() -> None:
    assert Motors((0.0, -0.0, 0.0, 0.0)).stopped
    assert not any(Motors(speeds).stopped for speeds in set(permutations((0.1, 0.0, 0.0, 0.0))))


def test_motors_take_nan_and_infinity_as_speeds() -> None:
    motors = Motors()
    motors.execute(b"\x01\x02" + pack("<BfBf", 0, math.nan, 1, math.inf))
    assert math.isnan(motors.speeds_rps[0])
    assert motors.speeds_rps[1] == math.inf
    assert not motors.stopped
    assert not motors.wild


@pytest.mark.parametrize("data", [b"\x00" + pack("<Bf", 4, 1.0), b"\x01\x01" + pack("<Bf", 255, 1.0), b"\x02\x04"])
def test_motors_write_wild_for_ids_out_of_range(data: bytes) -> None:
    motors = Motors((0.1, 0.2, 0.3, 0.4))
    assert motors.execute(data) == (0.1, 0.2, 0.3, 0.4)
    assert len(motors.wild) == 1
    assert motors.wild[0][0] >= framing.WHEELS


def test_motors_go_on_reading_beyond_the_data() -> None:
    motors = Motors((0.1, 0.2, 0.3, 0.4))
    motors.execute(bytes.fromhex(VECTORS["refuse"]["motor frame with n = 208 in 9 bytes"])[4:-1])
    # 208 entries from 9 bytes of data, the CRC and zeros: the first writes to 7, the second to 2 with its last bytes
    # missing, the others say wheel 0.
    assert (motors.wild[0][0], len(motors.wild), motors.speeds_rps[:2]) == (7, 208, [0.0, 0.2])
    motors = Motors((1.0,) * 4)
    motors.execute(b"\x02")
    assert (motors.wild, motors.speeds_rps) == ([(framing.crc8(b"\x03\x01\x02"), 0.0)], [1.0] * 4), "the CRC is next"


@pytest.mark.parametrize("data", [b"\x04\x01", b"\x07\x02", b"\xff", b"\x03\x00", b"\x03\xf0", b"\x01\x00"])
def test_motors_ignore_what_addresses_no_wheel(data: bytes) -> None:
    motors = Motors((0.1, 0.2, 0.3, 0.4))
    assert motors.execute(data) == (0.1, 0.2, 0.3, 0.4)
    assert not motors.wild

"""Telemetry's own records: every payload comes back as it went in, fits its record, and is damage in any other size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.procs.telemetry import charger, pad
from failstop.shm import records
from failstop.shm.layout import BY_NAME
from failstop.shm.slot import HEADER_BYTES, build

FLOAT = st.floats(allow_nan=False)
THREE = st.tuples(FLOAT, FLOAT, FLOAT)
HUGE = (1e308, -1e308, 1e308)

# Record, the biggest payload, its unpacking, its size, whether a longer one is damage.
EACH: dict[str, tuple[bytes, Callable[[bytes], Any], int, bool]] = {
    "bias": (records.pack_bias(HUGE, True, True), records.unpack_bias, 26, True),
    "odometry": (records.pack_odometry(HUGE, HUGE), records.unpack_odometry, 48, True),
    "battery": (records.pack_battery(2**32 - 1, 2), records.unpack_battery, 5, True),
    "pad": (records.pack_pad(65535, 255, -128, -128, 127, 127, 1), records.unpack_pad, 8, True),
    "pad_command": (records.pack_pad_command(*HUGE), records.unpack_pad_command, 24, True),
    # A wire frame has at most 260 bytes.
    "wishes": (records.pack_wish(records.WISH_FRAME, bytes(260)), records.unpack_wish, 1, False),
}


@given(bias=THREE, tracking=st.booleans(), calibrated=st.booleans())
def test_bias(bias: tuple[float, float, float], tracking: bool, calibrated: bool) -> None:
    assert records.unpack_bias(records.pack_bias(bias, tracking, calibrated)) == (bias, tracking, calibrated)


@given(pose=THREE, twist=THREE)
def test_odometry(pose: tuple[float, float, float], twist: tuple[float, float, float]) -> None:
    assert records.unpack_odometry(records.pack_odometry(pose, twist)) == (*pose, *twist)


@given(millivolts=st.integers(0, 2**32 - 1), plugged=st.sampled_from([0, 1, 2]))
def test_battery(millivolts: int, plugged: int) -> None:
    assert records.unpack_battery(records.pack_battery(millivolts, plugged)) == (millivolts, plugged)


@given(mode=st.sampled_from([0, 1]), lx=st.integers(-128, 127), buttons=st.integers(0, 65535))
def test_pad(mode: int, lx: int, buttons: int) -> None:
    assert records.unpack_pad(records.pack_pad(buttons, 9, lx, 1, -2, 3, mode)) == (buttons, 9, lx, 1, -2, 3, mode)


@given(velocity=THREE)
def test_pad_command(velocity: tuple[float, float, float]) -> None:
    assert records.unpack_pad_command(records.pack_pad_command(*velocity)) == velocity


@given(kind=st.integers(0, 255), frame=st.binary(max_size=260))
def test_wish(kind: int, frame: bytes) -> None:
    assert records.unpack_wish(records.pack_wish(kind, frame)) == (kind, frame)


@pytest.mark.parametrize("name", EACH)
def test_the_biggest_payload_fits(name: str) -> None:
    room = BY_NAME["telemetry"].records[name].capacity
    assert len(build(1, 1, EACH[name][0], 0, room)) <= HEADER_BYTES + room


def test_the_longest_note_fits() -> None:
    assert records.NOTE_BYTES == 280
    assert BY_NAME["telemetry"].records["notes"].capacity >= records.NOTE_BYTES


@pytest.mark.parametrize("name", EACH)
def test_a_wrong_size_is_a_value_error(name: str) -> None:
    _, unpack, size, exact = EACH[name]
    unpack(bytes(size))
    for wrong in [*range(size), *([size + 1, size + 8] if exact else [])]:
        with pytest.raises(ValueError, match=f"payload of {wrong} bytes"):
            unpack(bytes(wrong))


def test_the_numbers_have_their_names() -> None:
    assert records.PLUGGED[charger.UNKNOWN] == "unknown"
    assert records.PLUGGED[charger.PLUGGED] == "plugged"
    assert records.PLUGGED[charger.UNPLUGGED] == "unplugged"
    assert records.PAD_MODES[pad.LOCKED] == "locked"
    assert records.PAD_MODES[pad.DRIVE] == "drive"
    assert (records.WISH_RESET, records.WISH_FRAME) == (1, 2)

"""The bytes of keys, in both of a terminal's languages, whole and in pieces."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli.screen.hold import AXES
from failstop.cli.screen.keys import EVENTS, FOCUS_OUT, PRESS, RELEASE, REPEAT, Decoder, Key

PLAIN: tuple[tuple[bytes, list[Key]], ...] = (
    (b"w", [("w", PRESS)]),
    (b"W", [("w", PRESS)]),
    (b" ", [("space", PRESS)]),
    (b"\x1b[A\x1b[B\x1b[C\x1b[D", [("up", PRESS), ("down", PRESS), ("right", PRESS), ("left", PRESS)]),
    (b"\x1bOA", [("up", PRESS)]),
    (b"\x1b[1;2C", [("right", PRESS)]),
    (b"\r", [("enter", PRESS)]),
    (b"\x04", [("ctrl+d", PRESS)]),
    ("é".encode(), [("é", PRESS)]),
    (b"\x1b[O", [(FOCUS_OUT, PRESS)]),
    (b"\x1b[I", []),
    (b"\x1bw", [("esc", PRESS), ("w", PRESS)]),
    (b"\x1b[3~\x1b[15~", []),
    (b"\x1b[?62;c", []),
)
KITTY: tuple[tuple[bytes, list[Key]], ...] = (
    (b"\x1b[119u", [("w", PRESS)]),
    (b"\x1b[119;1:1u\x1b[119;1:2u\x1b[119;1:3u", [("w", PRESS), ("w", REPEAT), ("w", RELEASE)]),
    (b"\x1b[119:87;2u", [("w", PRESS)]),
    (b"\x1b[61:43;2:1u", [("+", PRESS)]),
    (b"\x1b[1;1:3A", [("up", RELEASE)]),
    (b"\x1b[99;5u\x1b[122;5:1u", [("ctrl+c", PRESS), ("ctrl+z", PRESS)]),
    (b"\x1b[32;1:1u", [("space", PRESS)]),
    (b"\x1b[57441;2:1u", [("\ue061", PRESS)]),
    (b"\x1b[?15u", [(EVENTS, PRESS)]),
    (b"\x1b[?1u", []),
    (b"\x1b[?0u", []),
)


@pytest.mark.parametrize(("data", "found"), PLAIN + KITTY)
def test_keys(data: bytes, found: list[Key]) -> None:
    assert Decoder().feed(data) == found


@pytest.mark.parametrize(("data", "found"), PLAIN + KITTY)
def test_keys_that_come_byte_by_byte(data: bytes, found: list[Key]) -> None:
    decoder = Decoder()
    assert [key for at in range(len(data)) for key in decoder.feed(data[at : at + 1])] == found


def test_half_an_arrow_is_no_letter() -> None:
    decoder = Decoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"[") == []
    assert decoder.feed(b"A") == [("up", PRESS)]


def test_what_is_pasted_is_no_key() -> None:
    assert Decoder().feed(b"\x1b[200~www \x1b[A\x1b[201~e") == [("e", PRESS)]


@given(st.binary(max_size=300))
def test_any_bytes_are_survived_and_the_keys_after_them_are_heard(data: bytes) -> None:
    decoder = Decoder()
    decoder.feed(data)
    decoder.feed(b"~" * 70 + b"\x1b[201~")
    assert decoder.feed(b" ") == [("space", PRESS)]


@given(st.integers(), st.integers(0, 9))
def test_numbers_out_of_range_are_no_keys_that_move(code: int, kind: int) -> None:
    found = Decoder().feed(f"\x1b[{abs(code)};1:{kind}u".encode())
    assert all(name not in AXES or abs(code) < 128 for name, _ in found)

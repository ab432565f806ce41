"""Signatures, the key's file, and what is taken for a message of the fleet."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.fleet import FleetError, levels, signed
from failstop.fleet.levels import Order, StopAnswer

KEY = bytes(range(32))
OTHER = bytes(32)
ORDER = Order("0" * 32, 1000.5, "smoke", "ann@desk")
ANSWER = StopAnswer("0" * 32, "robot-1", {levels.ASKED: 0.0, levels.WRITTEN: 0.01}, "")


def test_what_is_signed_is_read() -> None:
    assert levels.read_order(KEY, ORDER.message(KEY)) == ORDER
    assert levels.read_answer(KEY, ANSWER.message(KEY)) == ANSWER


@pytest.mark.parametrize("letter", ["x", "\0", '"', "\u20ac", "\U0001f916", "\udc80"])
def test_robots_read_a_stop_whatever_its_reason(letter: str) -> None:
    message = Order("f" * 32, 1e10 / 3, letter * 10_000, letter * 10_000).message(KEY)
    assert levels.read_order(KEY, message).id == "f" * 32


def test_another_key() -> None:
    with pytest.raises(signed.Forged, match="another key"):
        levels.read_order(KEY, ORDER.message(OTHER))


def test_an_answer_is_no_stop_and_a_stop_no_answer() -> None:
    with pytest.raises(signed.Forged, match="another key"):
        levels.read_order(KEY, ANSWER.message(KEY))
    with pytest.raises(signed.Forged, match="another key"):
        levels.read_answer(KEY, ORDER.message(KEY))


@given(st.integers(0), st.integers(1, 255))
def test_one_changed_byte_is_noticed_or_changes_nothing(at: int, change: int) -> None:
    message = bytearray(ORDER.message(KEY))
    message[at % len(message)] ^= change
    try:
        found = levels.read_order(KEY, bytes(message))
    except signed.Forged:
        return
    assert found == ORDER


@given(
    st.binary()
    | st.text().map(str.encode)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
        lambda inner: (
            st.lists(inner) | st.dictionaries(st.text(), inner) | st.fixed_dictionaries({"body": inner, "mac": inner})
        ),
    ).map(lambda value: json.dumps(value).encode())
)
def test_whatever_comes_is_forged_and_nothing_else(message: bytes) -> None:
    with pytest.raises(signed.Forged):
        levels.read_order(KEY, message)


@pytest.mark.parametrize(
    "message",
    [
        b"[" * 4000,
        b'{"body": "{}", "mac": "' + b"0" * 5000 + b'"}',
        b'{"body": "\\ud800", "mac": "00"}',
        b'{"body": "{}", "mac": "\\u00e9"}',
    ],
)
def test_messages_that_are_hard_to_read(message: bytes) -> None:
    with pytest.raises(signed.Forged):
        levels.read_order(KEY, message)


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"id": "0" * 32, "t": "now", "reason": "", "by": ""},
        {"id": "0" * 32, "t": True, "reason": "", "by": ""},
        {"id": "0" * 32, "t": 10**400, "reason": "", "by": ""},
        {"id": "../../x", "t": 1.0, "reason": "", "by": ""},
        {"id": 7, "t": 1.0, "reason": "", "by": ""},
        {"id": "0" * 32, "t": 1.0, "reason": None, "by": ""},
    ],
)
def test_who_has_the_key_can_make_nonsense_too(body: dict[str, object]) -> None:
    with pytest.raises(signed.Forged):
        levels.read_order(KEY, signed.sign(KEY, signed.STOP_PURPOSE, body))


@pytest.mark.parametrize("reached", [None, [], {"sent": 0.0}, {"written": "now"}, {"written": None}])
def test_levels_that_are_none(reached: object) -> None:
    body = {"id": "0" * 32, "robot": "r", "why": "", "reached": reached}
    with pytest.raises(signed.Forged):
        levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, body))


def test_texts_are_one_line_and_not_too_long() -> None:
    found = levels.read_order(KEY, Order("0" * 32, 1.0, "a\x1b[2Jb\n" + "x" * 500, "c\td").message(KEY))
    assert found.reason.startswith(r"a\x1b[2Jb\nxxx")
    assert len(found.reason) == levels.MOST_TEXT
    assert found.by == r"c\td"


def test_a_key_is_made_once_and_nobody_else_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "new" / "fleet.key"
    signed.make_key(str(path))
    assert path.stat().st_mode & 0o777 == 0o600
    assert len(signed.read_key(str(path))) == 32
    with pytest.raises(FleetError, match="exists already"):
        signed.make_key(str(path))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_a_key_that_others_may_read_or_write_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "key"
    signed.make_key(str(path))
    path.chmod(mode)
    with pytest.raises(FleetError, match="chmod 600"):
        signed.read_key(str(path))


def test_a_key_that_systemd_hands_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fleet.key"
    signed.make_key(str(path))
    path.chmod(0o440)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert signed.read_key(str(path))


@pytest.mark.parametrize("text", ["", "xyz", "00" * 31, "00" * 33, "é" * 32])
def test_a_file_that_is_no_key(tmp_path: Path, text: str) -> None:
    path = tmp_path / "key"
    path.touch(0o600)
    path.write_text(text)
    with pytest.raises(FleetError, match="not a fleet's key"):
        signed.read_key(str(path))


def test_no_key(tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="`failstop fleet key` makes one"):
        signed.read_key(str(tmp_path / "none"))


OLD_ANSWER = {"id": "0" * 32, "robot": "r", "why": "", "reached": {levels.WRITTEN: 0.1}}
"""As a failstop makes it whose publishers draw no numbers."""


def test_an_older_answer_is_read() -> None:
    found = levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, OLD_ANSWER))
    assert (found.publisher, found.doubled, found.connected_s) == ("", False, 0.0)


@pytest.mark.parametrize(
    ("given", "read"),
    [
        ({"publisher": "a" * 16, "doubled": True, "connected_s": 7}, ("a" * 16, True, 7.0)),
        ({"publisher": "../..", "doubled": "no", "connected_s": -1}, ("", True, 0.0)),
        ({"publisher": 7, "doubled": None, "connected_s": float("nan")}, ("", True, 0.0)),
        ({"publisher": [], "doubled": 0, "connected_s": float("inf")}, ("", True, 0.0)),
    ],
)
def test_what_an_answer_says_of_its_publisher(given: dict[str, object], read: tuple[str, bool, float]) -> None:
    """What can't be read counts as what makes the sender doubt."""
    found = levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, {**OLD_ANSWER, **given}))
    assert (found.publisher, found.doubled, found.connected_s) == read


def test_what_is_said_of_the_publisher_is_signed_and_read() -> None:
    whole = StopAnswer("0" * 32, "r", {}, "", levels.WRITTEN, "a" * 16, True, 3.5)
    assert levels.read_answer(KEY, whole.message(KEY)) == whole

"""Bytes of a broker, cut into packets: whatever came, in whatever pieces."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.fleet.wire import MOST_BYTES, Malformed, Message, MqttWire
from tests.fleet.flood import packet

OTHERS = (b"\x20\x02\x00\x00", b"\xd0\x00", b"\x90\x03\x00\x01\x80", packet("t", b"asks for an answer", 1))
"""CONNACK, PINGRESP, SUBACK, and a message with an acknowledgement: paho-mqtt's."""
MESSAGES = st.builds(packet, st.text(min_size=1, max_size=20), st.binary(max_size=300), st.just(0))


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    at = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [data[start:end] for start, end in itertools.pairwise(at)]


def read(*parts: bytes) -> tuple[MqttWire, list[Message], bytes]:
    wire = MqttWire()
    for part in parts:
        wire.feed(part)
    return wire, wire.messages(), wire.read(1 << 30)


@given(st.lists(MESSAGES | st.sampled_from(OTHERS), max_size=8), st.lists(st.integers(0, 3000), max_size=8))
def test_however_it_is_cut_all_arrives_in_order(packets: list[bytes], cuts: list[int]) -> None:
    wire, messages, rest = read(*pieces(b"".join(packets), cuts))
    assert [packet(topic, payload, 0) for topic, payload, _ in messages] == [p for p in packets if p[0] == 0x30]
    assert rest == b"".join(p for p in packets if p[0] != 0x30)
    assert wire.skipped == 0
    assert not wire.holds()


@pytest.mark.parametrize("size", [MOST_BYTES, 2_000_000])
@pytest.mark.parametrize("qos", [0, 1])
def test_one_that_is_too_long_is_skipped_and_never_held(size: int, qos: int) -> None:
    wire = MqttWire()
    data = packet("a", b"x", 0) + packet("t", bytes(size), qos) + packet("b", b"y", 0)
    for start in range(0, len(data), 5000):
        wire.feed(data[start : start + 5000])
        assert len(wire._bytes) <= LONGEST_HELD
    assert wire.messages() == [("a", b"x", False), ("b", b"y", False)]
    assert wire.skipped == 1
    assert not wire.holds()


LONGEST_HELD = 10
"""A packet that is too long: its head, and what came before it."""


@given(st.binary(min_size=1, max_size=8))
def test_a_topic_that_can_not_be_read_is_skipped(topic: bytes) -> None:
    body = len(topic).to_bytes(2, "big") + topic + b"payload"
    wire, messages, _ = read(bytes([0x30, len(body)]) + body + packet("b", b"y", 0))
    try:
        wanted = [(topic.decode(), b"payload", False)]
    except UnicodeDecodeError:
        wanted = []
    assert messages == [*wanted, ("b", b"y", False)]
    assert wire.skipped == (not wanted)


@pytest.mark.parametrize("body", [b"", b"\x00", b"\x00\x00x", b"\xff\xffx"])
def test_a_message_without_a_topic_is_skipped(body: bytes) -> None:
    _, messages, _ = read(bytes([0x30, len(body)]) + body + packet("b", b"y", 0))
    assert messages == [("b", b"y", False)]


def test_what_the_broker_had_kept_is_told_apart() -> None:
    kept = bytearray(packet("t", b"x", 0))
    kept[0] |= 1
    assert read(bytes(kept))[1] == [("t", b"x", True)]


@given(st.binary(max_size=400), st.lists(st.integers(0, 400), max_size=5))
def test_any_bytes_are_read_or_refused(data: bytes, cuts: list[int]) -> None:
    try:
        read(*pieces(data, cuts))
    except Malformed:
        assert max(data) >= 0x80


def test_a_length_that_does_not_end_is_refused() -> None:
    with pytest.raises(Malformed):
        read(b"\x30\xff\xff\xff\xff\x7f")

"""Handover of descriptors between processes: duplicates arrive, and nothing ever blocks or raises."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Iterator

import pytest

from failstop.messages.records import PATH_BYTES
from failstop.procs import handover
from failstop.procs.handover import Control
from tests.support.ptys import open_fds


@pytest.fixture
def ends() -> Iterator[tuple[Control, Control]]:
    mine, theirs = handover.pair()
    pair = Control(mine), Control(theirs)
    yield pair
    for end in pair:
        end.close()


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    both = os.pipe()
    yield both
    for fd in both:
        with contextlib.suppress(OSError):
            os.close(fd)


def test_a_duplicate_arrives_with_number_and_path_and_works(
    ends: tuple[Control, Control], pipe: tuple[int, int]
) -> None:
    ways = [(7, "/dev/böard", "/dev/böard"), (2**64 - 1, "ä" * PATH_BYTES, "ä" * (PATH_BYTES // 2))]
    for number, path, _ in ways:
        ends[0].send(pipe[1], number, path)
    for number, _, path in ways:  # in order, one at a time; a path that is too long is cut
        sent = ends[1].receive()
        assert sent is not None
        assert sent[1:] == (number, path)
        assert sent[0] not in pipe
        os.write(sent[0], b"stop")
        assert os.read(pipe[0], 10) == b"stop"
        for fd in (sent[0], *(end.fd for end in ends)):
            assert not os.get_inheritable(fd), "closed on exec unless it is passed on"
        os.close(sent[0])
    assert ends[1].receive() is None
    os.write(ends[0].fd, b"port")
    assert ends[1].receive() is None, "a message without a descriptor is nothing"


def send(end: Control, data: bytes, fd: int) -> None:
    """Send a descriptor with other bytes than send() would."""
    with socket.socket(fileno=os.dup(end.fd)) as raw:
        raw.sendmsg([data], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, struct.pack("i", fd))])


def test_a_path_that_is_no_text_is_shown_as_far_as_it_is(ends: tuple[Control, Control], pipe: tuple[int, int]) -> None:
    send(ends[0], struct.pack("<Q", 7) + b"/dev/\xff", pipe[1])
    sent = ends[1].receive()
    assert sent is not None
    assert sent[1:] == (7, "/dev/\ufffd")
    os.close(sent[0])


def test_a_message_that_is_too_long_is_cut_and_the_next_one_arrives(
    ends: tuple[Control, Control], pipe: tuple[int, int]
) -> None:
    send(ends[0], struct.pack("<Q", 7) + b"/" * (2 * PATH_BYTES), pipe[1])
    ends[0].send(pipe[1], 8, "/dev/b")
    for expected in ((7, "/" * PATH_BYTES), (8, "/dev/b")):
        sent = ends[1].receive()
        assert sent is not None
        assert sent[1:] == expected
        os.close(sent[0])


@pytest.mark.parametrize("data", [b"", bytes(7)])
def test_a_descriptor_without_a_number_is_no_port_and_is_not_kept(
    ends: tuple[Control, Control], pipe: tuple[int, int], data: bytes
) -> None:
    before = open_fds()
    send(ends[0], data, pipe[1])
    assert ends[1].receive() is None
    assert open_fds() == before


def test_a_peer_that_is_gone_is_no_error_and_what_it_had_sent_still_arrives(pipe: tuple[int, int]) -> None:
    mine, theirs = map(Control, handover.pair())
    mine.send(pipe[1], 1, "")
    mine.close()
    sent = theirs.receive()
    assert sent is not None
    os.close(sent[0])
    theirs.send(pipe[1], 1, "")
    assert theirs.receive() is None
    theirs.close()


def test_a_peer_that_takes_nothing_does_not_block(ends: tuple[Control, Control], pipe: tuple[int, int]) -> None:
    before = open_fds()
    for _ in range(500):
        ends[0].send(pipe[1], 1, "")
    assert open_fds() == before, "the sender's own descriptors are not used up"

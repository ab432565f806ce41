"""The native protocol of the journal, byte by byte, and when it is used."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from failstop.notify import Outbox
from failstop.supervisor.events import encode, is_journal
from tests.support.supervisor_scene import Scene


@pytest.mark.parametrize(
    ("name", "value", "data"),
    [
        ("MESSAGE", "STOP latched: key1", b"MESSAGE=STOP latched: key1\n"),
        ("PRIORITY", 4, b"PRIORITY=4\n"),
        ("FAILSTOP_WAIT_S", 0.1, b"FAILSTOP_WAIT_S=0.1\n"),
        ("FAILSTOP_WHO", "a=b", b"FAILSTOP_WHO=a=b\n"),
        ("FAILSTOP_WHO", "", b"FAILSTOP_WHO=\n"),
        ("FAILSTOP_WHO", "\u2713\udcff", b"FAILSTOP_WHO=\xe2\x9c\x93?\n"),
        ("MESSAGE", "a\nPRIORITY=0", b"MESSAGE\n\x0c\0\0\0\0\0\0\0a\nPRIORITY=0\n"),
        ("MESSAGE", "\n", b"MESSAGE\n\x01\0\0\0\0\0\0\0\n\n"),
    ],
)
def test_a_field_is_encoded_byte_by_byte(name: str, value: str | int | float, data: bytes) -> None:
    assert encode([(name, value)]) == data


def test_an_entry_is_one_datagram(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "socket"))
        sender = Outbox(str(tmp_path / "socket"))
        assert sender.send(encode([("MESSAGE", "one"), ("PRIORITY", 5)]))
        assert sender.send(encode([("MESSAGE", "two")]))
        assert server.recv(1000) == b"MESSAGE=one\nPRIORITY=5\n"
        assert server.recv(1000) == b"MESSAGE=two\n"
        sender.close()


def test_a_journal_that_comes_back_is_used_again(tmp_path: Path) -> None:
    path = tmp_path / "socket"
    sender = Outbox(str(path))
    assert not sender.send(encode([("MESSAGE", "nobody")]))
    for _ in range(2):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
            server.bind(str(path))
            assert sender.send(encode([("MESSAGE", "here")]))
        path.unlink()
        assert not sender.send(encode([("MESSAGE", "nobody")]))
    sender.close()


def test_a_stderr_that_is_the_journal_s_alone_means_the_journal(scene: Scene) -> None:
    is_its = scene.load("failstop.supervisor.events").is_journal
    found = scene.os.fstat(2)
    assert is_its(f"{found.st_dev}:{found.st_ino}")
    for device, inode in ((0, 1), (1, 0)):
        assert not is_its(f"{found.st_dev + device}:{found.st_ino + inode}")
    scene.os.close(2)
    assert not is_its(f"{found.st_dev}:{found.st_ino}"), "there is none"


@pytest.mark.parametrize("stream", ["", "8", "8:", ":9", "x:y", "1:2:3"])
def test_a_word_that_is_no_stream_is_none(stream: str) -> None:
    assert not is_journal(stream)

"""The native protocol of the journal, byte by byte, and when it is used."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.supervisor import events
from failstop.supervisor.events import Outbox, encode, is_journal


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
def test_one_field(name: str, value: str | int | float, data: bytes) -> None:
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


ASK = "import os; from failstop.supervisor.events import is_journal; print(is_journal(os.environ['JOURNAL_STREAM']))"


@pytest.mark.parametrize(("offset", "answer"), [(0, "True\n"), (1, "False\n")])
def test_only_a_stderr_that_is_the_journal_s_means_the_journal(tmp_path: Path, offset: int, answer: str) -> None:
    """In a process of its own, whose stderr is a file."""
    with open(tmp_path / "stderr", "wb") as file:
        found = os.fstat(file.fileno())
        environment = {**os.environ, "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino + offset}"}
        done = subprocess.run(
            [sys.executable, "-c", ASK], stdout=subprocess.PIPE, stderr=file, env=environment, text=True
        )
    assert done.stdout == answer


def test_without_a_stderr_there_is_no_journal_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "STDERR", 1 << 20)
    assert not is_journal("8:9")


@pytest.mark.parametrize("stream", ["", "8", "8:", ":9", "x:y", "1:2:3"])
def test_what_is_no_stream_is_none(stream: str) -> None:
    assert not is_journal(stream)

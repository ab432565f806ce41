"""Events: lines for people, entries for the journal, cells for programs - and never a reason to stop working."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest

from failstop.api.events import unpack
from failstop.notify import Outbox
from failstop.supervisor import kinds
from failstop.supervisor.events import (
    EVENT_BYTES,
    LONGEST_HOLD_NS,
    MOST_EVENTS_WAITING,
    encode,
    is_journal,
    journal_entry,
    ring_entry,
    say,
)
from tests.support.supervisor_scene import Scene


@contextlib.contextmanager
def stderr_is(fd: int) -> Iterator[None]:
    """Another descriptor in the place of descriptor 2; inside the test, since the test runner moves it about too."""
    saved = os.dup(2)
    os.dup2(fd, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


@pytest.mark.parametrize(
    ("message", "line"),
    [("STOP latched: key1", b"failstop: STOP latched: key1\n"), ("\udcff \u2713", "failstop: ? \u2713\n".encode())],
)
def test_say_writes_one_line(pipe: tuple[int, int], message: str, line: bytes) -> None:
    with stderr_is(pipe[1]):
        say(message)
    assert os.read(pipe[0], 1000) == line


def test_a_pipe_that_nobody_reads_does_not_hold_up_the_supervisor(pipe: tuple[int, int]) -> None:
    """A plain write would block forever, and the watch over every process with it."""
    while select.select((), (pipe[1],), (), 0)[1]:
        os.write(pipe[1], bytes(4096))
    before = time.monotonic()
    with stderr_is(pipe[1]):
        for _ in range(5):
            say("STOP latched: key1")
    assert time.monotonic() - before < 5


@pytest.mark.starts
def test_a_terminal_that_nobody_reads_does_not_hold_up_the_supervisor() -> None:
    """It reports room as long as it has any, and would then wait for room for the rest of a message."""
    program = """
import os, pty, sys
from failstop.supervisor.events import say, without_waiting

_master, terminal = pty.openpty()
os.dup2(terminal, 2)
fd = without_waiting()
assert not os.get_blocking(fd) and os.get_blocking(2)
for at in range(3000):
    say("word " * (8 + at * 7 % 40), fd)
print("never blocked")
"""
    done = subprocess.run((sys.executable, "-c", program), capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "never blocked\n"


@pytest.mark.parametrize("closed", [False, True])
def test_a_stderr_that_nobody_reads_any_more_is_no_error(closed: bool) -> None:
    out, into = os.pipe()
    os.close(out)
    with stderr_is(into):
        if closed:
            os.close(2)
        say("STOP latched: key1")
    os.close(into)


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
def test_a_field_of_the_journal_is_encoded_byte_by_byte(name: str, value: str | int | float, data: bytes) -> None:
    assert encode([(name, value)]) == data


def test_a_journal_gets_datagrams_while_it_takes_them_and_holds_nobody_up(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = Outbox(str(path))
    entry = encode([("MESSAGE", "one"), ("PRIORITY", 5)])
    assert not journal.send(entry)
    for _ in range(2):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journald:
            journald.bind(str(path))
            assert journal.send(entry)
            assert journald.recv(1000) == b"MESSAGE=one\nPRIORITY=5\n"
            taken = 0
            while journal.send(b"again"):
                taken += 1
                assert taken < 100_000
            journald.recv(100)
            assert journal.send(b"again"), "and it is used again"
        path.unlink()
        assert not journal.send(entry)
    journal.close()


def test_a_stderr_that_is_the_journal_s_alone_means_the_journal() -> None:
    scene = Scene()
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


class Journal:
    """Datagrams that the journal has got, while it is there."""

    def __init__(self) -> None:
        self.got: list[bytes] = []
        self.there = True

    def send(self, datagram: bytes) -> bool:
        if self.there:
            self.got.append(datagram)
        return self.there


@pytest.fixture
def journal() -> Journal:
    return Journal()


@pytest.fixture
def scene(journal: Journal) -> Scene:
    return Scene(journal=journal)


def test_an_event_goes_to_the_journal_and_into_the_ring_and_not_to_stderr(scene: Scene, journal: Journal) -> None:
    scene.run.events.log("enabled", "motion enabled by nav (pid 7)", {"who": "nav", "pid": 7, "left_out": None})
    told_ns = scene.now_ns
    scene.now_ns += LONGEST_HOLD_NS
    scene.run.events.flush()
    assert scene.stderr.heard == []
    assert scene.events() == [
        {
            "t": (scene.machine.unix_ns + told_ns) / 1e9,
            "ns": told_ns,
            "kind": "enabled",
            "level": "notice",
            "text": "motion enabled by nav (pid 7)",
            "fields": {"who": "nav", "pid": 7},
        }
    ]
    assert journal.got == [
        (
            "MESSAGE=motion enabled by nav (pid 7)\nPRIORITY=5\nMESSAGE_ID=3bfd144a1c00461f861da553c93614d9\n"
            "SYSLOG_IDENTIFIER=failstop\nFAILSTOP_EVENT=enabled\nFAILSTOP_NAME=stage\n"
            f"FAILSTOP_MONOTONIC_NS={told_ns}\nFAILSTOP_WHO=nav\nFAILSTOP_PID=7\n"
        ).encode()
    ]


def test_an_event_without_its_journal_is_a_line_on_stderr(scene: Scene, journal: Journal) -> None:
    journal.there = False
    scene.run.events.log("stop", "STOP latched: key1", {"reason": "key1"})
    assert len(scene.said()) == 1
    assert scene.stderr.heard == [b"failstop: STOP latched: key1\n"]


def test_a_stderr_that_takes_nothing_is_no_error(scene: Scene, journal: Journal) -> None:
    journal.there = False
    scene.refuse("write", OSError(errno.EIO, os.strerror(errno.EIO)), lambda fd, _: fd == 2)
    scene.run.events.log("note", "here")
    assert len(scene.said()) == 1


def test_nothing_is_sent_before_flush_and_not_while_a_stop_is_on_its_way(scene: Scene, journal: Journal) -> None:
    scene.run.events.log("stop_also", "also: key1", {"reason": "key1"})
    scene.run.events.flush(scene.now_ns, hold=True)
    assert scene.events() == journal.got == []
    scene.run.events.flush(scene.now_ns, hold=False)
    assert len(scene.events()) == len(journal.got) == 1


def test_a_stop_that_can_not_be_written_does_not_hold_events_for_ever(scene: Scene) -> None:
    scene.run.events.log("note", "here")
    scene.run.events.flush(scene.now_ns + LONGEST_HOLD_NS - 1, hold=True)
    assert scene.events() == []
    scene.run.events.flush(scene.now_ns + LONGEST_HOLD_NS, hold=True)
    assert [event["text"] for event in scene.events()] == ["here"]


def test_programs_are_told_how_much_was_left_out(scene: Scene) -> None:
    for _ in range(MOST_EVENTS_WAITING + 7):
        scene.run.events.log("stop", "x", {"reason": "x"}, level="critical")
    text = "7 events of the kind stop were left out: too many to log each one"
    assert scene.said()[-1] == ("left_out", "critical", text, {"of": "stop", "count": 7})


def test_a_kind_that_nobody_knows_is_a_note_and_a_level_too(scene: Scene, journal: Journal) -> None:
    scene.run.events.log("surprise", "boo", level="loud")
    scene.run.events.log("scan", "scan is back", level="info")
    assert [told[:2] for told in scene.said()] == [("note", "info"), ("scan", "info")]
    assert b"PRIORITY=6\n" in journal.got[1]


@pytest.mark.parametrize("size", [1, 47, 200, 5_000, 100_000])
def test_every_event_fits_into_its_cell(size: int) -> None:
    fields: dict[str, str | int | float] = {"reason": "\u2713" * size, "who": "\udcff" * size, "epoch": 2**63}
    data = ring_entry(2**62, 1.7e9, "stop_outcome", "critical", "\u2713" * size, fields)
    assert len(data) <= EVENT_BYTES
    found = msgpack.unpackb(data)
    assert (found["kind"], found["ns"]) == ("stop_outcome", 2**62)
    assert found["text"].startswith("\u2713")
    assert found["fields"].keys() == fields.keys()


def test_fields_that_do_not_fit_however_short_are_left_out() -> None:
    data = ring_entry(1, 1.0, "note", "info", "a text for people", {f"field_{i}": "x" * 30 for i in range(100)})
    assert len(data) <= EVENT_BYTES
    found = unpack(1, data)
    assert found
    assert (found.text, found.next, found.fields) == ("a text for people", "", {})


@pytest.mark.parametrize("step", ["", "restart it; next: look again"])
def test_programs_find_the_step_apart_from_the_text(scene: Scene, step: str) -> None:
    scene.run.events.log("note", "the port; next: the board", step=step)
    scene.run.events.flush()
    found = unpack(1, msgpack.packb(scene.events()[0]))
    assert found
    assert (found.what, found.next) == ("the port; next: the board", step)


def test_the_journal_s_entry_has_a_level_and_an_id_for_every_kind() -> None:
    for kind in kinds.EVENT_KINDS:
        lines = journal_entry("x", 1, kind.name, kind.level, "text", {}).decode().splitlines()
        found = dict(line.split("=", 1) for line in lines)
        assert 2 <= int(found["PRIORITY"]) <= 6
        assert found["MESSAGE_ID"] == kind.message_id

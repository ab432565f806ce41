"""Events: lines for people, entries for the journal, cells for programs - and never a reason to stop working."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.procs.world import World
from failstop.shm import layout, segment
from failstop.shm.cell import RingReader
from failstop.supervisor import kinds
from failstop.supervisor.events import LONGEST_HOLD_NS, MOST_WAITING, ROOM, Events, Outbox, journal_entry, pack, say
from tests.supervisor.streams import stderr_is


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("STOP latched: key1", b"failstop: STOP latched: key1\n"),
        ("\udcff \u2713", "failstop: ? \u2713\n".encode()),
    ],
)
def test_one_line(pipe: tuple[int, int], message: str, line: bytes) -> None:
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


def test_a_pipe_whose_reader_has_gone_is_no_error() -> None:
    out, into = os.pipe()
    os.close(out)
    with stderr_is(into):
        say("STOP latched: key1")
    os.close(into)


def test_a_closed_stderr_is_no_error() -> None:
    saved = os.dup(2)
    os.close(2)
    try:
        say("STOP latched: key1")
    finally:
        os.dup2(saved, 2)
        os.close(saved)


class Scene:
    """Events with a ring of their own, and a journal's socket."""

    def __init__(self, directory: Path) -> None:
        self.name = f"v{os.getpid()}x{time.monotonic_ns()}"
        segment.create(self.name, layout.SUPERVISOR, 7).close()
        own = segment.attach(self.name, layout.SUPERVISOR, write=True)
        self._reader: RingReader = own.ring_reader("events")
        self._path = str(directory / "journal")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind(self._path)
        self._journal = Outbox(self._path)
        self.events = Events(World(), self.name, own.ring_writer("events"), self._journal)

    def ring(self) -> list[dict[str, Any]]:
        found = []
        while entry := self._reader.next():
            found.append(msgpack.unpackb(entry[2]))
            assert entry[1] == found[-1]["ns"]
        return found

    def journal(self) -> list[bytes]:
        found = []
        while select.select((self._socket,), (), (), 0)[0]:
            found.append(self._socket.recv(65536))
        return found

    def lose_the_journal(self) -> None:
        self._socket.close()
        os.unlink(self._path)

    def close(self) -> None:
        self._journal.close()
        self._socket.close()
        segment.unlink_all(self.name)


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.close()


def test_an_event_goes_to_the_journal_and_into_the_ring_and_not_to_stderr(scene: Scene, pipe: tuple[int, int]) -> None:
    before = time.time()
    with stderr_is(pipe[1]):
        scene.events.tell("enabled", "motion enabled by nav (pid 7)", {"who": "nav", "pid": 7, "left_out": None})
        scene.events.flush()
    assert not select.select((pipe[0],), (), (), 0)[0]
    (found,) = scene.ring()
    assert before <= found.pop("t") <= time.time()
    t_ns = found.pop("ns")
    assert found == {
        "kind": "enabled",
        "level": "notice",
        "text": "motion enabled by nav (pid 7)",
        "fields": {"who": "nav", "pid": 7},
    }
    assert scene.journal() == [
        (
            "MESSAGE=motion enabled by nav (pid 7)\nPRIORITY=5\nMESSAGE_ID=3bfd144a1c00461f861da553c93614d9\n"
            f"SYSLOG_IDENTIFIER=failstop\nFAILSTOP_EVENT=enabled\nFAILSTOP_NAME={scene.name}\n"
            f"FAILSTOP_MONOTONIC_NS={t_ns}\nFAILSTOP_WHO=nav\nFAILSTOP_PID=7\n"
        ).encode()
    ]


def test_without_its_journal_an_event_is_a_line_on_stderr(scene: Scene, pipe: tuple[int, int]) -> None:
    scene.lose_the_journal()
    with stderr_is(pipe[1]):
        scene.events.tell("stop", "STOP latched: key1", {"reason": "key1"})
        scene.events.flush()
    assert os.read(pipe[0], 1000) == b"failstop: STOP latched: key1\n"
    assert len(scene.ring()) == 1


def test_a_journal_that_is_full_holds_nobody_up(scene: Scene, pipe: tuple[int, int]) -> None:
    with stderr_is(pipe[1]):
        for _ in range(MOST_WAITING):
            scene.events.tell("note", "again")
            scene.events.flush()
    told = len(scene.journal())
    assert 0 < told < MOST_WAITING, "the rest went to stderr"
    assert os.read(pipe[0], 1_000_000).count(b"failstop: again\n") == MOST_WAITING - told


def test_nothing_is_sent_before_flush_and_not_while_a_stop_is_on_its_way(scene: Scene) -> None:
    scene.events.tell("stop_also", "also: key1", {"reason": "key1"})
    now_ns = time.monotonic_ns()
    scene.events.flush(now_ns, hold=True)
    assert scene.ring() == scene.journal() == []
    scene.events.flush(now_ns, hold=False)
    assert len(scene.ring()) == len(scene.journal()) == 1


def test_a_stop_that_can_not_be_written_does_not_hold_events_for_ever(scene: Scene) -> None:
    scene.events.tell("note", "here")
    scene.events.flush(time.monotonic_ns() + LONGEST_HOLD_NS, hold=True)
    assert [event["text"] for event in scene.ring()] == ["here"]


def test_what_was_left_out_is_counted_for_programs_too(scene: Scene) -> None:
    for _ in range(MOST_WAITING + 7):
        scene.events.tell("stop", "x", {"reason": "x"}, level="critical")
    scene.events.flush()
    *_, told = scene.ring()
    assert (told["kind"], told["level"], told["fields"]) == ("left_out", "critical", {"of": "stop", "count": 7})
    assert told["text"] == "7 events of the kind stop were left out: too many to tell of each"


def test_a_kind_that_nobody_knows_is_a_note_and_a_level_too(scene: Scene) -> None:
    scene.events.tell("surprise", "boo", level="loud")
    scene.events.tell("scan", "scan is back", level="info")
    scene.events.flush()
    assert [(event["kind"], event["level"]) for event in scene.ring()] == [("note", "info"), ("scan", "info")]
    assert b"PRIORITY=6\n" in scene.journal()[1]


@pytest.mark.parametrize("size", [1, 47, 200, 5_000, 100_000])
def test_every_event_fits_into_its_cell(size: int) -> None:
    fields: dict[str, str | int | float] = {"reason": "\u2713" * size, "who": "\udcff" * size, "epoch": 2**63}
    data = pack(2**62, 1.7e9, "stop_outcome", "critical", "\u2713" * size, fields)
    assert len(data) <= ROOM
    found = msgpack.unpackb(data)
    assert (found["kind"], found["ns"]) == ("stop_outcome", 2**62)
    assert found["text"].startswith("\u2713")
    assert found["fields"].keys() == fields.keys()


def test_fields_that_do_not_fit_however_short_are_left_out() -> None:
    data = pack(1, 1.0, "note", "info", "text", {f"field_{i}": "x" * 30 for i in range(100)})
    assert len(data) <= ROOM
    assert msgpack.unpackb(data)["fields"] == {}


def test_the_journal_s_entry_has_a_level_and_an_id_for_every_kind() -> None:
    for kind in kinds.KINDS:
        lines = journal_entry("x", 1, kind.name, kind.level, "text", {}).decode().splitlines()
        found = dict(line.split("=", 1) for line in lines)
        assert 2 <= int(found["PRIORITY"]) <= 6
        assert found["MESSAGE_ID"] == kind.message_id

"""One port for all three, or none: what the supervisor does when it is lost, back, or missing somewhere."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board.burst import BURST
from failstop.policy.settings import Settings
from failstop.procs.handover import Control
from failstop.shm import layout, records, segment
from failstop.shm.heartbeat import RUNNING
from failstop.supervisor import children
from failstop.supervisor.children import WAITING
from failstop.supervisor.main import ALONE_EVERY_NS
from failstop.supervisor.port_handover import SHARE_NS
from tests.support.ptys import Pty
from tests.support.supervisor_scene import MS, Scene

NOBODY = 2**31 - 1
OTHERS = (layout.PORT_OWNER, layout.STOPPER)


class Three(Scene):
    """A supervisor whose port owner and stopper the test plays, and the opener's thread."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self._held = [os.dup(self.port.fd)]  # else the board's side of a pty reads an error
        self.path = directory / "board"
        self.handover = self.supervisor.handover
        self.handover.opener.finder._path = self.handover.opener.finder.at = str(self.path)
        self.stopper = segment.attach(self.run.memory, layout.STOPPER, write=True)
        stopper = self.supervisor.processes[layout.STOPPER]
        stopper.state, stopper.pid = children.RUNNING, NOBODY
        self.stopper.word("beat_pid").set(NOBODY)
        self.stopper.word("beat_state").set(RUNNING)
        self.ends = {name: Control(os.dup(self.run.controls[name][1])) for name in OTHERS}
        self.record(records.PORT_OPEN)
        self.stopper_has(1)
        self.turn()

    def record(self, state: int, number: int = 1) -> None:
        """What the port owner says of a port."""
        packed = records.PORT.pack(number, self.now_ns, state, str(self.path))
        self.port_owner.latest_writer("port").write(packed)

    def stopper_has(self, number: int) -> None:
        self.stopper.word("port_number").set(number)

    def has(self, name: str, number: int) -> None:
        self.record(records.PORT_OPEN, number) if name == layout.PORT_OWNER else self.stopper_has(number)

    def received(self, name: str) -> list[tuple[int, str]]:
        """Number and path of each port that was sent to it."""
        found = []
        while sent := self.ends[name].receive():
            os.close(sent[0])
            found.append(sent[1:])
        return found

    def turn(self, elapsed_ns: int = 0) -> bytes:
        self.stopper.word("beat_ns").set(self.now_ns + elapsed_ns)
        return super().turn(elapsed_ns)

    def lose(self) -> None:
        """The port owner finds it gone, and the supervisor sees that."""
        self.record(records.PORT_LOST)
        self.stopper_has(0)
        self.turn()
        assert self.port.fd < 0

    def comes_back(self, *, full: bool = False) -> int:
        """The device is there again, as another pty, and opened; returns the board's side. `full`: it takes nothing
        until then."""
        pty = Pty()
        self._held += [pty.master, pty.slave]
        self.path.symlink_to(pty.link)
        held = pty.fill() if full else 0
        assert self.handover.opener._asked.acquire(False), "it is looked for"
        assert self.handover.opener.attempt()
        while held and select.select([pty.master], [], [], 20.0)[0]:
            held -= len(os.read(pty.master, held))
        return pty.master

    def waits_for_its_restart(self) -> None:
        """The port owner has died."""
        child = self.supervisor.processes[layout.PORT_OWNER]
        child.state, child.pid = WAITING, 0
        child.restart.set(self.now_ns + 10**12)

    def close(self) -> None:
        for end in self.ends.values():
            end.close()
        for fd in self._held:
            os.close(fd)
        super().close()


@pytest.fixture
def three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Three]:
    made = Three(tmp_path, monkeypatch)
    yield made
    made.close()


def wrote(master: int) -> bytes:
    try:
        return os.read(master, 65536)
    except BlockingIOError:
        return b""


@pytest.mark.parametrize("name", OTHERS)
def test_complete_only_with_everybody_s_own_descriptor_of_this_very_port(three: Three, name: str) -> None:
    assert three.handover.complete()
    for number in (0, 2):
        three.has(name, number)
        assert not three.handover.complete()
    three.has(name, 1)
    assert three.handover.complete()
    three.record(records.PORT_LOST)
    assert not three.handover.complete()


def test_a_port_that_is_back_is_stopped_before_the_supervisor_turns(three: Three) -> None:
    three.lose()
    three.turn(100 * MS)
    master = three.comes_back()
    assert wrote(master) == BURST
    assert three.supervisor.loop.wait(0), "its bell has rung"
    before_ns = three.word("written_ns").get()
    three.turn()
    assert three.port.fd >= 0
    assert wrote(master) == b""
    assert three.word("written_ns").get() > before_ns, "the opener's burst is the supervisor's"


@pytest.mark.parametrize("name", OTHERS)
def test_and_sent_to_each_until_it_has_it(three: Three, name: str) -> None:
    three.lose()
    three.comes_back()
    (other,) = set(OTHERS) - {name}
    three.turn()
    three.has(other, 2)
    assert three.received(name) == [(2, str(three.path))], "it did not arrive: no number was free, say"
    assert three.received(other) == [(2, str(three.path))]
    three.turn(SHARE_NS - 1)
    assert three.received(name) == []
    three.turn(1)
    assert len(three.received(name)) == 1
    three.has(name, 2)
    three.turn(SHARE_NS)
    assert (three.received(name), three.received(other)) == ([], [])
    assert three.handover.complete()


@pytest.mark.parametrize("name", OTHERS)
def test_one_that_is_starting_inherits_it_and_gets_it_when_it_runs_without(three: Three, name: str) -> None:
    segment.attach(three.run.memory, name, write=True).word("beat_state").set(RUNNING - 1)
    three.supervisor.processes[name].state = children.STARTING
    three.has(name, 0)
    three.turn(SHARE_NS)
    assert three.received(name) == []
    segment.attach(three.run.memory, name, write=True).word("beat_state").set(RUNNING)
    three.turn()
    assert len(three.received(name)) == 1


def test_one_that_waits_for_its_restart_is_sent_nothing(three: Three) -> None:
    three.waits_for_its_restart()
    three.lose()
    three.comes_back()
    three.turn()
    assert three.received(layout.PORT_OWNER) == [], "it would stay open in the queue"
    assert len(three.received(layout.STOPPER)) == 1


def test_its_loss_and_its_return_are_told_once_each(three: Three) -> None:
    three.events()
    three.lose()
    three.turn(MS)
    three.turn(1_233 * MS + 400_000)
    three.comes_back()
    for _ in range(3):
        three.turn()
    told = [event for event in three.events() if event["kind"].startswith("device_")]
    path = three.path
    assert [(event["kind"], event["text"]) for event in told] == [
        ("device_lost", f"{path} is gone; the stop is written the moment it is back; wheels that turn: POWER SWITCH"),
        ("device_back", f"{path} is back after 1.2 s; the stop is written"),
    ]
    assert [event["fields"] for event in told] == [{"path": str(path)}, {"path": str(path), "away_s": 1.234}]


@pytest.mark.parametrize(("number", "lost"), [(0, False), (1, True), (2, False)])
def test_what_the_port_owner_says_of_another_port_is_no_loss_of_this_one(three: Three, number: int, lost: bool) -> None:
    """It may be late, and speak of the one before."""
    three.record(records.PORT_LOST, number)
    three.turn()
    assert (three.port.fd < 0) is lost


def test_a_burst_that_the_opener_could_not_write_is_written_by_the_loop_and_told_with_the_stop_that_waited(
    three: Three,
) -> None:
    three.lose()
    three.gate_stops()
    three.turn()
    three.answers()
    three.turn()
    assert three.told()["written_us"] is None, "nobody has a port to write it on"
    master = three.comes_back(full=True)
    assert wrote(master) == b""
    three.turn(7 * MS)
    assert wrote(master) == BURST
    assert (three.told()["written_by"], three.told()["written_us"]) == ("supervisor", 7_000.0)


def test_of_a_port_that_is_gone_nobody_says_that_its_board_answers(three: Three) -> None:
    def link() -> bytes:
        entry = segment.attach(three.run.memory, layout.SUPERVISOR).latest_reader("link").read()
        assert entry is not None
        return entry[2]

    three.port_owner.word("ping_0").set(three.now_ns)
    telemetry = segment.attach(three.run.memory, layout.TELEMETRY, write=True)
    telemetry.word("pong").set(records.pong(three.now_ns + MS, 0))
    three.turn(2 * MS)
    assert link() == b"alive"
    three.lose()
    three.turn(MS)
    assert link() == b"unproven"


def test_while_the_port_owner_has_no_port_the_supervisor_repeats_the_stop(three: Three) -> None:
    """At its pace, from the burst of the opener on."""
    three.lose()
    three.turn(ALONE_EVERY_NS)
    master = three.comes_back()
    three.turn()
    assert wrote(master) == BURST
    opened_ns = three.supervisor._tried_ns
    three.now_ns = opened_ns
    three.turn(ALONE_EVERY_NS - 1)
    assert wrote(master) == b""
    three.turn(1)
    assert wrote(master) == BURST
    three.has(layout.PORT_OWNER, 2)
    three.turn(ALONE_EVERY_NS)
    assert wrote(master) == b"", "it says zero itself"


def test_a_port_that_has_gone_again_before_anybody_heard_of_it_is_lost_again(three: Three) -> None:
    three.lose()
    master = three.comes_back()
    three.turn()
    os.close(master)
    three._held.remove(master)
    three.path.unlink()
    three.turn()
    assert three.port.fd < 0
    three.comes_back()
    three.turn()
    assert three.received(layout.STOPPER) == [(2, str(three.path)), (3, str(three.path))]


def test_the_settings_name_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(tmp_path, monkeypatch)
    assert scene.supervisor.handover.opener.finder.at == Settings().text("device.path")
    scene.close()

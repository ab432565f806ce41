"""One port for all three, or none: what the supervisor does when a descriptor is missing somewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board.burst import BURST
from failstop.board.finder import Finder
from failstop.policy.settings import Settings
from failstop.procs.handover import OPENING_NS, Control
from failstop.shm import layout, records, segment
from failstop.shm.heartbeat import RUNNING
from failstop.supervisor import sharing
from failstop.supervisor.main import ALONE_EVERY_NS
from failstop.supervisor.port import REOPEN_NS
from failstop.supervisor.sharing import KEPT_NS, SHARE_NS

from .test_answers import MS, Scene

NOBODY = 2**31 - 1


class Three(Scene):
    """A supervisor whose port owner and stopper the test plays."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self._held = [os.dup(self.port.fd)]  # else the board's side of a pty reads an error
        self.killed: list[int] = []
        monkeypatch.setattr(os, "kill", lambda pid, number: self.killed.append(pid))
        self.path = directory / "board"
        self.sharing = self.supervisor._sharing
        self.sharing._finder = Finder(str(self.path))
        self.port.since_ns = self.now_ns
        self.stopper = segment.attach(self.resources.memory, layout.STOPPER, write=True)
        self.supervisor.family[layout.STOPPER].pid = NOBODY
        self.stopper.word("beat_pid").set(NOBODY)
        self.stopper.word("beat_state").set(RUNNING)
        self.control = Control(os.dup(self.resources.controls[layout.STOPPER][1]))
        self.record(records.PORT_OPEN)

    def record(self, state: int) -> None:
        """What the port owner says of its port."""
        packed = records.pack_port(1, self.now_ns, state, str(self.path))
        self.port_owner.latest_writer("port").write(packed)

    def stopper_has(self) -> None:
        self.stopper.word("port_ns").set(self.now_ns)

    def received(self) -> int:
        """How many descriptors have been sent to the stopper."""
        count = 0
        while (fd := self.control.receive()) >= 0:
            os.close(fd)
            count += 1
        return count

    def turn(self, elapsed_ns: int = 0) -> bytes:
        self.stopper.word("beat_ns").set(self.now_ns + elapsed_ns)
        return super().turn(elapsed_ns)

    def lose(self) -> None:
        """The device has gone, and the supervisor has seen it."""
        self.sharing._let_go()
        self.port.since_ns = self.now_ns

    def comes_back(self) -> int:
        """The device is there again, as another pty; returns the board's side."""
        master, slave = os.openpty()
        self._held += [master, slave]
        os.set_blocking(master, False)
        self.path.symlink_to(os.ttyname(slave))
        return master

    def waits_for_its_restart(self) -> None:
        """The port owner has died."""
        child = self.supervisor.family[layout.PORT_OWNER]
        child.pid, child.restart_ns = 0, self.now_ns + 10**12

    def close(self) -> None:
        self.control.close()
        for fd in self._held:
            os.close(fd)
        super().close()


@pytest.fixture
def three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Three]:
    made = Three(tmp_path, monkeypatch)
    yield made
    made.close()


def test_complete_only_with_the_stopper_s_own_descriptor(three: Three) -> None:
    assert not three.sharing.complete()
    three.stopper_has()
    assert three.sharing.complete()
    three.record(records.PORT_LOST)
    assert not three.sharing.complete()


def test_a_stopper_with_the_port_of_before_does_not_count(three: Three) -> None:
    three.stopper_has()
    three.port.since_ns = three.now_ns + 1
    assert not three.sharing.complete()


def test_the_stopper_is_sent_the_port_until_it_has_it(three: Three) -> None:
    three.turn()
    assert three.received() == 1, "it did not arrive: no number was free, say"
    three.turn(SHARE_NS - 1)
    assert three.received() == 0
    three.turn(1)
    assert three.received() == 1
    three.stopper_has()
    three.turn(SHARE_NS)
    assert three.received() == 0


def test_one_that_is_starting_inherits_it(three: Three) -> None:
    three.stopper.word("beat_state").set(RUNNING - 1)
    three.turn(SHARE_NS)
    assert three.received() == 0


def test_a_port_owner_that_keeps_the_port_is_ended(three: Three) -> None:
    three.lose()
    three.record(records.PORT_OPEN)
    three.turn(KEPT_NS - 1)
    assert three.killed == []
    three.turn(1)
    assert three.killed == [NOBODY]
    told = three.events()[-1]
    text = "the port did not get to the supervisor: port_owner is ended, so that the supervisor can open it"
    assert (told["kind"], told["text"], told["fields"]) == ("waiting", text, {"for": "the port"})
    fence = three.supervisor.family[layout.PORT_OWNER].fence
    assert fence
    assert not fence.was_starved
    assert fence.fields().keys() == {"silent_ms", "kill_us"}, "it is told of no stop: none was written for that"
    assert fence.fields()["silent_ms"] == 0.0
    three.turn(MS)
    assert three.killed == [NOBODY], "once"


def test_what_the_port_owner_says_of_the_device_is_told(three: Three, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "monotonic_ns", lambda: three.now_ns)
    for state in (records.PORT_LOST, records.PORT_OPEN):
        three.now_ns += MS
        three.record(state)
        three.turn()
    told = [event["kind"] for event in three.events()]
    assert [kind for kind in told if kind.startswith("device_")] == ["device_lost", "device_back"]


def test_but_not_for_what_it_said_before_the_port_was_lost(three: Three) -> None:
    three.now_ns += 2 * KEPT_NS
    three.lose()
    three.turn(KEPT_NS - 1)
    assert three.killed == []


def test_nor_while_the_supervisor_could_not_open_it(three: Three, monkeypatch: pytest.MonkeyPatch) -> None:
    three.lose()

    def no_number(fd: int) -> int:
        raise OSError(24, "Too many open files")

    with monkeypatch.context() as patched:
        patched.setattr(os, "dup", no_number)
        three.turn(KEPT_NS)
        assert three.killed == []
    three.turn(MS)
    assert three.killed == [NOBODY]


def test_nobody_is_ended_while_the_device_is_away(three: Three) -> None:
    three.lose()
    three.record(records.PORT_LOST)
    three.turn(3 * KEPT_NS)
    assert three.killed == []


def test_a_port_that_is_back_is_opened_while_the_port_owner_waits_for_its_restart(three: Three) -> None:
    three.lose()
    three.waits_for_its_restart()
    three.turn()
    assert three.supervisor.next_ns(three.now_ns) <= three.now_ns + REOPEN_NS
    three.comes_back()
    three.turn(REOPEN_NS)
    assert three.port.fd >= 0
    assert three.received() == 1, "and the stopper has it too"


def test_at_once_and_then_at_its_own_pace(three: Three) -> None:
    """The burst does not wait for the rate of the bursts."""
    three.lose()
    three.waits_for_its_restart()
    three.turn(ALONE_EVERY_NS)
    master = three.comes_back()
    three.turn(REOPEN_NS)
    assert os.read(master, 65536) == BURST
    three.turn(ALONE_EVERY_NS - 1)
    with pytest.raises(BlockingIOError):
        os.read(master, 65536)
    three.turn(1)
    assert os.read(master, 65536) == BURST


def test_one_that_lives_opens_it_itself(three: Three) -> None:
    three.lose()
    three.port_owner.word("beat_state").set(RUNNING - 1)
    three.comes_back()
    three.turn(ALONE_EVERY_NS)
    assert three.port.fd < 0


def test_a_lost_port_is_looked_for_only_while_no_port_owner_lives(three: Three) -> None:
    assert three.sharing.next_ns(three.now_ns) is None
    three.lose()
    assert three.sharing.next_ns(three.now_ns) is None, "that one opens it"
    three.waits_for_its_restart()
    assert three.sharing.next_ns(three.now_ns) == three.now_ns + REOPEN_NS


def test_patience_is_for_an_opening_alone(three: Three) -> None:
    assert three.sharing.patience_ns(three.now_ns) == 0
    three.lose()
    three.path.symlink_to("/dev/null")
    assert three.sharing.patience_ns(three.now_ns + 150 * MS) == OPENING_NS
    three.path.unlink()
    assert three.sharing.patience_ns(three.now_ns + 150 * MS) == 0
    three.path.symlink_to("/dev/null")
    assert three.sharing.patience_ns(three.now_ns + 200 * MS) == 0, "it was silent before the device was back"


def test_the_settings_name_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(tmp_path, monkeypatch)
    assert scene.supervisor._sharing._finder.at == Settings().text("device.path")
    scene.close()

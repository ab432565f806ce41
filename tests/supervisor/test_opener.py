"""The opener: a thread that opens the lost port and stops on it, and holds nobody up."""

from __future__ import annotations

import os
import queue
import sys
from pathlib import Path
from typing import Any, NoReturn

import pytest

from failstop.board.finder import Finder
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.shm.bell import EventBell
from failstop.supervisor.port_handover import LOOK_NS, Opener
from failstop_lab.machine.process import Thread
from tests.support.children import scheduled
from tests.support.stage import MS
from tests.support.supervisor_scene import DEVICE, Scene


@pytest.fixture
def scene() -> Scene:
    """The supervisor has let the port go, which is there."""
    made = Scene()
    made.port.close()
    return made


@pytest.fixture
def opener(scene: Scene) -> Any:
    return scene.supervisor.handover.opener


def test_a_port_that_is_not_there_is_not_opened(scene: Scene, opener: Any) -> None:
    scene.wire.unplug()
    for _ in range(2):
        before = len(scene.fds())
        assert not opener.attempt()
        assert opener.pop() is None
        assert len(scene.fds()) == before


def test_the_burst_is_its_first_bytes_and_it_is_taken_once(scene: Scene, opener: Any) -> None:
    assert opener.attempt()
    assert scene.wire.read() == BURST
    fd, written_ns = opener.pop()
    assert scene.me.files[fd].node is scene.wire.port
    assert written_ns == scene.now_ns
    assert opener.pop() is None


def test_a_burst_that_was_not_written_is_not_said_to_be(scene: Scene, opener: Any) -> None:
    scene.wire.fill()
    assert opener.attempt()
    assert opener.pop()[1] == 0


def test_the_opener_has_a_number_when_no_other_is_free(scene: Scene, opener: Any) -> None:
    scene.wire.unplug()
    opener.attempt()  # so that it keeps the lowest
    scene.plug()
    before = scene.fds()
    lowest = scene.os.dup(0)
    scene.os.close(lowest)
    scene.me.most_files = lowest
    with pytest.raises(OSError, match="Too many open files"):
        scene.os.dup(0)
    for _ in range(2):
        assert opener.attempt(), "without a number to keep it goes on with what there is"
        scene.os.close(opener.pop()[0])
        assert len(before - scene.fds()) == 1, "who has no number to give back closes no other's"


def test_the_opener_s_thread_opens_each_lost_port_and_holds_nobody_up(scene: Scene, opener: Any) -> None:
    slept: list[int] = []
    took_ns = 3_000 * MS

    def slow(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        if thread is not scene.machine.inline and call == "sleep":
            slept.append(scene.now_ns)
        if thread is not scene.machine.inline and call == "open" and about[0] == DEVICE:
            scene.machine.block(scene.now_ns + took_ns)

    scene.wire.unplug()
    opener.begin()
    scene.machine.at_seam = slow
    began_ns = scene.now_ns
    opener.look()
    scene.now_ns += 2 * LOOK_NS
    for times in range(2):
        scene.plug()
        if times:
            opener.look()
        scene.now_ns += LOOK_NS
        opened_ns = scene.now_ns
        assert opener.pop() is None, "and this thread goes on"
        scene.now_ns += took_ns
        fd, written_ns = opener.pop()
        assert opened_ns <= written_ns <= scene.now_ns
        assert scene.wire.read() == BURST
        scene.os.close(fd)
        scene.wire.unplug()
    assert slept == [began_ns, began_ns + LOOK_NS, began_ns + 2 * LOOK_NS], "and it rests when it has opened one"


@pytest.mark.parametrize(("settled", "looks"), [(True, 3), (False, 60)])
def test_while_the_port_is_open_the_devices_are_listed_and_an_answer_counts_once(
    scene: Scene, opener: Any, settled: bool, looks: int
) -> None:
    """They are listed more often while the open device may not be the board."""
    calls: list[str] = []

    class Counted(scene.load("failstop.board.finder").Finder):  # type: ignore[misc]
        @property
        def settled(self) -> bool:
            return settled

        def believe(self) -> None:
            calls.append("believe")

        def look_around(self) -> None:
            calls.append("look")

    opener.finder = Counted(DEVICE, BOARD.port)
    opener.begin()
    scene.machine.run(lambda: bool(calls), MS)
    calls.clear()
    opener.believed = True
    scene.machine.run(lambda: False, 3_040 * MS)
    assert calls == ["believe", *["look"] * looks]


class Watched(Finder):
    """It notes how the thread that looks is scheduled; one look is all."""

    __slots__ = ("found",)

    def __init__(self, path: str) -> None:
        super().__init__(path, BOARD.port)
        self.found: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()

    def open(self, now_ns: int) -> NoReturn:
        self.found.put((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
        sys.exit()


def test_the_opener_s_thread_has_the_supervisor_s_rights_to_run(tmp_path: Path) -> None:
    """The kernel takes them from what a process starts; without them a busy machine would put the stop off."""
    finder, bell = Watched(str(tmp_path / "board")), EventBell.create()
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # as procs/rights.py has it
    opener = Opener(finder, BOARD, bell)
    try:
        with scheduled(policy, 3):
            opener.begin()
    except PermissionError:
        pytest.skip("needs the right to real-time scheduling")
    opener.look()
    assert finder.found.get(timeout=20.0) == (policy, 3)
    os.close(bell.fd)

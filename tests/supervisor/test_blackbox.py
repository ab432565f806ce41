"""The black box: what is sampled, when a saver is started and with what, and what is told of its end."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.policy.settings import Settings
from failstop.procs.world import World, reap, spawn
from failstop.shm import box, layout, segment
from failstop.supervisor import blackbox, starter
from failstop.supervisor.blackbox import (
    COPY_NS,
    MOST_SAVERS,
    NEXT,
    PATIENCE_NS,
    SAMPLE_NS,
    START_NS,
    BlackBox,
)
from failstop.supervisor.events import Events
from failstop.supervisor.run import Run
from failstop.supervisor.stops import Stop
from tests.support.played import PlayedWorld
from tests.support.waiting import until
from tests.support.why import why

MS = 1_000_000
T0 = 10**12
_numbers = itertools.count()


def word(told: object) -> str:
    """A saver's, as printf(1) writes it."""
    return "".join(f"\\{byte:03o}" for byte in msgpack.packb(told))


SAID = word({"id": "0012"})


class Told(Events):
    """Keeps what is told, and how often it was sent."""

    def __init__(self) -> None:
        super().__init__(World(), "left")
        self.told: list[tuple[str, str, object, str]] = []
        self.flushed = 0

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.told.append((kind, text, fields, level))

    def flush(self, now_ns: int = 0, *, hold: bool = False) -> None:
        self.flushed += 1


class Scene:
    """A black box whose savers are shells: they wait to be hastened, say a word and end with a code."""

    def __init__(self, directory: Path) -> None:
        self.world = PlayedWorld(now_ns=lambda: T0)
        self.world.play("spawn", self.spawn)
        self.settings = Settings({"incidents.keep": 7, "incidents.max_mb": 8})
        self.run = Run(self.world, self.settings, f"box{os.getpid()}x{next(_numbers)}", str(directory))
        self.run.publish()
        memory, processes = self.run.memory, layout.PROCESSES
        self.beat = {process: segment.attach(memory, process, write=True).word("beat_ns") for process in processes}
        self._ring = segment.attach(memory, layout.SUPERVISOR).ring_reader("box")
        self.run.events = self.events = Told()
        self.now_ns = T0
        """When what is read next was written."""
        self.word, self.code = SAID, 0
        self.started: list[dict[str, str]] = []
        self.pids: list[int] = []
        self.box = self.new()

    def new(self, **changed: object) -> BlackBox:
        changes = {f"incidents.{key}": value for key, value in changed.items()}
        self.run.settings = Settings({**self.settings.flat(), **changes})
        return BlackBox(self.run)

    def spawn(self, arguments: list[str], environ: dict[str, str], passed: list[int]) -> int:
        """In the place of the saver's own program."""
        assert arguments[3].endswith("/incidents/saver.py")
        assert environ == starter.environment(self.settings)
        words = dict(word.split("=", 1) for word in arguments[4:])
        fds = [int(part.partition(":")[2]) for part in words["fds"].split(",")]
        assert passed == [int(words["hurry"]), *fds]
        assert words["hurry"] == words["result"]
        self.started.append(words)
        script = f'head -c 1 <&3 >/dev/null; printf "{self.word}" >&3; exit {self.code}'
        shell = f"import os; os.dup2({words['hurry']}, 3); os.execv('/bin/sh', ['sh', '-c', {script!r}])"
        self.pids.append(spawn([sys.executable, "-I", "-S", "-c", shell], dict(os.environ), passed))
        return self.pids[-1]

    def records(self) -> list[bytes]:
        found = []
        while entry := self._ring.next():
            assert entry[1] == self.now_ns
            found.append(entry[2])
        return found

    def ages_ms(self) -> list[list[tuple[float, float]]]:
        """Of each sample since the last call: each process's longest silence, and how long before that was seen."""
        return [[(a / 1e3, b / 1e3) for a, b in box.unpack_beats(record)] for record in self.records()]

    def ends(self) -> None:
        """The oldest saver ends, and a turn later that is known."""
        pid = next(iter(self.box._savers))
        self.box._hasten(pid)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        self.box.follow(T0, ready=True)
        assert pid not in self.box._savers

    def close(self) -> None:
        while self.box._savers:
            self.ends()
        self.run.remove()
        pipes = (self.run.stop_pipe, self.run.client_bell, self.run.published)
        bells = (bell.fd for bell in self.run.bells.values())
        for fd in (*pipes, *bells, *itertools.chain(*self.run.controls.values())):
            os.close(fd)


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    yield made
    made.close()


CAUSE = Stop(T0, layout.GATE, why("gate died"))


def test_the_longest_silence_of_each_process_is_sampled_ten_times_a_second(scene: Scene) -> None:
    scene.box.follow(T0, ready=True)
    assert scene.ages_ms() == [[(0.0, 0.0)] * len(layout.PROCESSES)], "nobody has beaten yet"
    for elapsed_ms in (20, 90):
        scene.box.follow(T0 + elapsed_ms * MS, ready=True)
        scene.beat[layout.GATE].set(T0 + elapsed_ms * MS)
    scene.beat[layout.SUPERVISOR].set(T0 + 95 * MS)
    scene.box.follow(T0 + SAMPLE_NS - 1, ready=True)
    assert scene.ages_ms() == []
    scene.beat[layout.STOPPER].set(T0 + 60 * MS)
    scene.now_ns = T0 + SAMPLE_NS
    scene.box.follow(T0 + SAMPLE_NS, ready=True)
    (found,) = scene.ages_ms()
    assert dict(zip(layout.PROCESSES, found, strict=True)) == {
        "supervisor": (5.0, 0.0),
        "port_owner": (0.0, 0.0),
        "gate": (70.0, 10.0),
        "telemetry": (0.0, 0.0),
        "stopper": (40.0, 0.0),
    }


def test_a_burst_of_the_supervisor_s_own_is_in_it(scene: Scene) -> None:
    scene.box.wrote(T0)
    assert scene.records() == [box.OWN_BURST_RECORD]


def test_a_saver_is_started_a_while_after_a_latched_stop(scene: Scene) -> None:
    scene.box.latched(CAUSE, 7)
    assert len(scene.records()) == 1, "a sample at once: what led to it"
    scene.box.follow(T0 + START_NS - 1, ready=True)
    assert scene.started == []
    scene.box.follow(T0 + START_NS, ready=True)
    scene.box.follow(T0 + 2 * START_NS, ready=True)
    (words,) = scene.started
    fds = ",".join(f"{process}:{fd}" for process, fd in scene.run.readable.items())
    expected = {"name": scene.run.name, "keep": "7", "max_mb": "8", "fds": fds, "cause": CAUSE.cause.pack().hex()}
    assert words.items() >= {**expected, "cause_ns": str(T0), "epoch": "7", "until_ns": str(T0 + COPY_NS)}.items()


def test_no_more_than_a_few_at_one_time(scene: Scene) -> None:
    scene.box.latched(CAUSE, 7)
    scene.box.follow(T0 + START_NS, ready=True)
    for epoch in range(8, 18):
        scene.box.latched(CAUSE, epoch)
    for _ in range(10):
        scene.box.follow(T0 + START_NS, ready=True)
    assert [words["epoch"] for words in scene.started] == ["7", "8", "9", "10"]
    assert len(scene.started) == MOST_SAVERS
    scene.ends()
    scene.box.latched(CAUSE, 30)
    scene.box.follow(T0 + START_NS, ready=True)
    assert scene.started[-1]["epoch"] == "30"


def test_nothing_is_saved_where_that_is_off(scene: Scene) -> None:
    off = scene.new(save="off")
    off.latched(CAUSE, 7)
    scene.run.left = {process: os.dup(0) for process in layout.PROCESSES}
    off.begin()
    off.follow(T0 + START_NS, ready=True)
    assert scene.started == []


SAVED = "incident 0012 saved; next: `failstop incident show 0012 --name left`"


@pytest.mark.parametrize(
    ("word", "code", "told"),
    [
        (SAID, 0, [("incident", SAVED, {"id": "0012"}, "")]),
        (SAID, 3, "the saver ended with code 3"),
        (word({}), 0, []),
        (word({}), 3, "the saver ended with code 3"),
        (word({"wrong": "no room\n"}), 1, "no room?"),
        (word({"wrong": 7}), 1, "7"),
        ("\\377", 1, "the saver ended with code 1"),
        (word(["id"]), 0, "the saver ended with code 0"),
        ("", 3, "the saver ended with code 3"),
        ("", 0, "the saver ended with code 0"),
        ("", "$(kill -9 $$)", "the saver was killed by signal 9"),
    ],
)
def test_what_is_told_of_its_end(scene: Scene, word: str, code: int, told: str | list[Any]) -> None:
    scene.word, scene.code = word, code
    scene.box.latched(CAUSE, 7)
    scene.box.follow(T0 + START_NS, ready=True)
    scene.ends()
    if isinstance(told, str):
        why = f"{told}; {NEXT}"
        told = [("incident", f"incident not saved: {why}", {"reason": why}, "warning")]
    assert scene.events.told == told


def test_a_saver_that_can_not_be_started_leaves_nothing_open(scene: Scene) -> None:
    def refused(*_: object) -> int:
        raise OSError(11, "Resource temporarily unavailable")

    scene.world.play("spawn", refused)
    before = os.listdir("/proc/self/fd")
    scene.box.latched(CAUSE, 7)
    scene.box.follow(T0 + START_NS, ready=True)
    assert os.listdir("/proc/self/fd") == before
    why = f"cannot start the saver: [Errno 11] Resource temporarily unavailable; {NEXT}"
    assert scene.events.told == [("incident", f"incident not saved: {why}", {"reason": why}, "warning")]


def test_what_a_saver_had_is_closed_after_its_end(scene: Scene) -> None:
    before = os.listdir("/proc/self/fd")
    scene.box.latched(CAUSE, 7)
    scene.box.follow(T0 + START_NS, ready=True)
    assert len(os.listdir("/proc/self/fd")) == len(before) + 1
    assert all(saver.gettimeout() == 0 for saver in scene.box._savers.values()), "nor is it waited for"
    scene.ends()
    assert os.listdir("/proc/self/fd") == before


def left_behind(scene: Scene, count: int) -> list[int]:
    """Segments of a dead run."""
    fds = [os.open("/dev/null", os.O_RDONLY) for _ in range(count)]
    scene.run.left = dict(zip(layout.PROCESSES, fds, strict=False))
    return fds


def ended(pid: int, options: int = os.WNOHANG) -> bool:
    """Whether a saver has been hastened: it waits for that, and ends then."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | options) is not None


def closed(fd: int) -> bool:
    return not os.path.exists(f"/proc/self/fd/{fd}")


def test_a_dead_run_s_saver_copies_when_this_run_is_ready(scene: Scene) -> None:
    fds = left_behind(scene, len(layout.PROCESSES))
    scene.box.begin()
    (words,) = scene.started
    assert words["until_ns"] == str(T0 + PATIENCE_NS)
    assert words["fds"] == ",".join(f"{process}:{fd}" for process, fd in zip(layout.PROCESSES, fds, strict=True))
    assert all(map(closed, fds)), "they are the saver's now"
    scene.box.latched(CAUSE, 7)
    scene.box.follow(T0 + START_NS, ready=False)
    dead, live = scene.box._savers
    assert not ended(dead)
    scene.box.follow(T0 + START_NS, ready=True)
    assert ended(dead, 0)
    assert not ended(live)
    scene.box.follow(T0 + START_NS, ready=True)


def test_a_dead_run_s_saver_takes_no_processor_time_from_a_run_that_is_not_ready(scene: Scene) -> None:
    kept: list[socket.socket] = []

    def spawned(arguments: list[str], environ: dict[str, str], passed: list[int]) -> int:
        kept.append(socket.socket(fileno=os.dup(passed[0])))
        return scene.spawn(arguments, environ, passed)

    scene.world.play("spawn", spawned)
    left_behind(scene, len(layout.PROCESSES))
    scene.box.begin()
    scene.box.follow(T0, ready=False)
    with contextlib.closing(kept[0]) as hurry:
        with pytest.raises(BlockingIOError):
            hurry.recv(1, socket.MSG_DONTWAIT)
        scene.box.follow(T0, ready=True)
        assert hurry.recv(1, socket.MSG_DONTWAIT) == b""


def test_a_dead_run_s_saver_that_is_killed_before_this_run_is_ready_costs_nothing_but_the_incident(
    scene: Scene,
) -> None:
    """As the one process that the kernel takes when memory is short."""
    left_behind(scene, len(layout.PROCESSES))
    scene.box.begin()
    (pid,) = scene.pids
    os.kill(pid, signal.SIGKILL)
    assert ended(pid, 0)
    for ready in (False, True):
        scene.box.follow(T0, ready=ready)
    why = f"the saver was killed by signal 9; {NEXT}"
    assert scene.events.told == [("incident", f"incident not saved: {why}", {"reason": why}, "warning")]


def test_of_a_dead_run_that_is_not_whole_nothing_is_saved(scene: Scene) -> None:
    fds = left_behind(scene, len(layout.PROCESSES) - 1)
    scene.box.begin()
    assert scene.started == []
    assert all(map(closed, fds))


def test_at_the_end_of_the_service_what_waits_is_saved_at_once(scene: Scene) -> None:
    scene.box.latched(CAUSE, 7)
    scene.box.latched(CAUSE, 8)
    scene.box.finish()
    assert [words["epoch"] for words in scene.started] == ["7", "8"]
    assert scene.box._savers == {}
    assert [text for _, text, _, _ in scene.events.told] == [SAVED, SAVED]
    assert scene.events.flushed == 1


def test_without_a_descriptor_to_wait_with_each_is_hastened_all_the_same(
    scene: Scene,
) -> None:
    def refused(_pid: int) -> int:
        raise OSError(24, "Too many open files")

    scene.world.play("lifeline", refused)
    scene.box.latched(CAUSE, 7)
    scene.box.latched(CAUSE, 8)
    for _ in range(2):
        scene.box.follow(T0 + START_NS, ready=True)
    pids = tuple(scene.box._savers)
    scene.world.play("reap", lambda _pid: None)
    scene.box.finish()
    assert all(ended(pid, 0) for pid in pids)
    scene.world.play("reap", reap)


def test_the_end_of_the_service_does_not_wait_for_a_saver_that_hangs(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blackbox, "FINISH_S", 0.01)
    scene.word = "$(sleep 1)"
    scene.box.latched(CAUSE, 7)
    scene.box.finish()
    assert len(scene.box._savers) == 1
    until(lambda: scene.box.follow(T0, ready=True) or not scene.box._savers, "its end")

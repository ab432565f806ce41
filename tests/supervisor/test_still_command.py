"""still.command: run once for each stop that the wheels do not obey, whatever became of it at the stop before."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import pytest

from failstop.lab.trial import wait_for
from failstop.policy import causes
from failstop.policy.settings import Settings
from failstop.shm import layout, segment
from failstop.shm.lifeline import Lifeline
from failstop.supervisor.aftermath import Aftermath
from failstop.supervisor.latch import Latch
from failstop.supervisor.run import Run
from failstop.supervisor.stops import Stop
from tests.support.played import PlayedWorld
from tests.support.why import why

S = 1_000_000_000
UNSTILL = str(causes.UNSTILL())
MS = 1_000_000
NEVER_ENDS = "echo $$ >> {file}; while :; do sleep 120; done"


class Scene:
    """An Aftermath whose IMU says that the wheels turn."""

    def __init__(self, directory: Path, command: str) -> None:
        self.file = directory / "ran"
        self.file.touch()
        settings = Settings({"still.command": command.format(file=self.file), "still.after_s": 1.0})
        self.texts: list[str] = []
        self.told: list[tuple[str, object, str]] = []
        self.kinds: list[str] = []
        self.world = PlayedWorld()
        self.run = Run(self.world, settings, f"still{os.getpid()}", str(directory))
        self.run.publish()
        self.run.events.tell = self._tell  # type: ignore[method-assign,assignment]
        self.latch = Latch()
        self.held = False
        self.aftermath = Aftermath(self.run, self.latch, lambda: self.held)
        self.telemetry = segment.attach(self.run.memory, layout.TELEMETRY, write=True)
        self.now_ns = 100 * S
        self.run.world.now_ns = lambda: self.now_ns
        self.epoch = 1

    def _tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.kinds.append(kind)
        if kind == "command":
            self.texts.append(text)
            self.told.append((text, fields, level))

    def follow(self, elapsed_ns: int, *, still: bool = False) -> list[str]:
        self.now_ns += elapsed_ns
        self.telemetry.word("still_ns").set(self.now_ns if still else 0)
        self.telemetry.word("judged_ns").set(self.now_ns)
        return [str(stop.cause) for stop in self.aftermath.follow(self.now_ns, listening=False)]

    def stop_unheeded(self) -> None:
        """People have reset, and a new stop is not obeyed."""
        self.latch.reset(self.epoch, self.now_ns)
        self.follow(MS)
        self.stop()
        assert self.follow(S) == [UNSTILL]

    def stop(self) -> None:
        self.epoch += 1
        stop = Stop(self.now_ns, layout.GATE, why(f"stop {self.epoch}"))
        stop.answered_by("port owner", self.now_ns, stop, self.epoch)
        self.aftermath.answered(stop, ending=False)
        self.follow(MS)

    def last_stop(self) -> dict[str, object]:
        entry = segment.attach(self.run.memory, layout.SUPERVISOR).latest_reader("stop").read()
        assert entry
        found: dict[str, object] = msgpack.unpackb(entry[2])
        return found

    def runs(self) -> list[int]:
        return [int(word) for word in self.file.read_text().split()]

    def close(self) -> None:
        for pid in self.aftermath._command_pids:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        self.run.remove()
        for fd in (self.run.stop_pipe, self.run.client_bell, self.run.published):
            os.close(fd)
        for bell in self.run.bells.values():
            os.close(bell.fd)
        for pair in self.run.controls.values():
            for fd in pair:
                os.close(fd)


@pytest.fixture
def scene_of(tmp_path: Path) -> Iterator[Callable[[str], Scene]]:
    made: list[Scene] = []

    def make(command: str) -> Scene:
        made.append(Scene(tmp_path, command))
        return made[-1]

    yield make
    for scene in made:
        scene.close()


def test_one_that_has_not_ended_is_killed_and_run_anew(scene_of: Callable[[str], Scene]) -> None:
    scene = scene_of(NEVER_ENDS)
    scene.stop_unheeded()
    wait_for("the command", lambda: len(scene.runs()) == 1)
    first = scene.runs()[0]
    scene.stop_unheeded()
    wait_for("the command again", lambda: len(scene.runs()) == 2)
    again = f"still.command (pid {first}) has not ended since an earlier stop: killed, and run again"
    assert scene.told[1] == (again, {"state": "hangs", "pid": first}, "error")

    def collected() -> bool:
        scene.follow(MS)
        return f"still.command (pid {first}) ended with code -9" in scene.texts

    wait_for("the first to be collected", collected)
    assert scene.aftermath._command_pids == scene.runs()[1:]


def test_what_one_that_hangs_has_started_is_killed_with_it(scene_of: Callable[[str], Scene]) -> None:
    scene = scene_of("sleep 120 & echo $! >> {file}; wait")
    scene.stop_unheeded()
    wait_for("the command", lambda: len(scene.runs()) == 1)
    life = Lifeline(scene.runs()[0])
    scene.stop_unheeded()
    assert life.wait(20.0)
    life.close()


def test_once_for_one_stop(scene_of: Callable[[str], Scene]) -> None:
    scene = scene_of(NEVER_ENDS)
    scene.stop_unheeded()
    assert scene.follow(S) == [UNSTILL], "stopped again"
    (pid,) = scene.aftermath._command_pids
    command = NEVER_ENDS.format(file=scene.file)
    assert scene.told == [(f"still.command runs (pid {pid}): {command}", {"state": "runs", "pid": pid}, "")]


def test_again_for_the_next_stop_once_the_wheels_were_still(scene_of: Callable[[str], Scene]) -> None:
    """Though the supervisor has not seen the reset in between."""
    scene = scene_of("echo $$ >> {file}")
    scene.stop_unheeded()
    wait_for("the command", lambda: len(scene.runs()) == 1)
    scene.follow(MS, still=True)
    scene.latch.reset(scene.epoch, scene.now_ns)
    scene.stop()
    assert scene.follow(S) == [UNSTILL]
    wait_for("the command again", lambda: len(scene.runs()) == 2)


def test_one_that_has_ended_is_not_told_to_hang(scene_of: Callable[[str], Scene]) -> None:
    scene = scene_of("echo $$ >> {file}")
    for number in (1, 2):
        scene.stop_unheeded()

        def collected(number: int = number) -> bool:
            scene.follow(MS)
            return sum("ended with code 0" in text for text in scene.texts) == number

        wait_for("its end", collected)
    assert len(scene.texts) == 4
    _, fields, level = scene.told[3]
    pid = scene.runs()[1]
    assert (fields, level) == ({"state": "ended", "pid": pid, "code": 0}, "")


def test_one_that_can_not_be_started_is_told_of(
    scene_of: Callable[[str], Scene],
) -> None:
    scene = scene_of("true")

    def refused(*_: object, **__: object) -> int:
        raise OSError(11, "Resource temporarily unavailable")

    scene.world.play("spawn", refused)
    scene.stop_unheeded()
    reason = "[Errno 11] Resource temporarily unavailable"
    text = f"cannot run still.command (true): {reason}"
    assert scene.told == [(text, {"state": "failed", "reason": reason}, "error")]


def test_one_that_may_not_be_killed_keeps_no_stop_from_its_command(
    scene_of: Callable[[str], Scene],
) -> None:
    scene = scene_of(NEVER_ENDS)
    scene.stop_unheeded()

    def refused(_pid: int, _number: int) -> None:
        raise PermissionError(1, "Operation not permitted")

    may = scene.world.play("kill", refused)
    scene.stop_unheeded()
    scene.world.play("kill", may)
    wait_for("the command again", lambda: len(scene.runs()) == 2)
    assert any("cannot be killed" in text for text in scene.texts)


def test_clients_are_told_of_a_stop_that_the_kernel_still_holds(scene_of: Callable[[str], Scene]) -> None:
    scene = scene_of("true")
    scene.held = True
    scene.stop()
    assert scene.last_stop()["sent"] is True, "nobody has looked yet"
    scene.follow(10 * S)
    assert scene.last_stop()["sent"] is False


def test_clients_are_told_once_of_a_stop_of_which_nothing_more_is_learnt(scene_of: Callable[[str], Scene]) -> None:
    """What became of it is told to people; nothing of what clients read has changed."""
    scene = scene_of("true")
    scene.stop()
    record = segment.attach(scene.run.memory, layout.SUPERVISOR).latest_reader("stop")
    written = record.read()
    scene.follow(10 * S)
    assert scene.kinds[-1] == "stop_outcome"
    assert record.read() == written

"""The family when the machine is short of something: no process that nobody watches, and it is tried again."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.procs.loop import READ
from failstop.shm import layout
from failstop.supervisor import children
from failstop.supervisor.family import TRY_AGAIN_NS
from failstop.supervisor.starter import Starter

from .test_answers import Scene


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


def test_a_process_that_can_not_be_watched_is_not_left_running(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[int] = []

    def start(*_: object) -> int:
        started.append(os.posix_spawnp("sleep", ["sleep", "120"], os.environ))
        return started[-1]

    def no_descriptor(_pid: int) -> None:
        raise OSError(24, "Too many open files")

    family = scene.supervisor.family
    monkeypatch.setattr(Starter, "start", start)
    monkeypatch.setattr(children, "Lifeline", no_descriptor)
    gate = family[layout.GATE]
    family.start(gate, -1)
    (pid,) = started
    assert not os.path.exists(f"/proc/{pid}")
    assert (gate.pid, gate.life, gate.state()) == (0, None, "waiting")
    assert gate.restart_ns is not None
    assert gate.restart_ns > TRY_AGAIN_NS
    scene.supervisor._events.flush()
    (event,) = scene.events()
    assert (event["kind"], event["fields"]["process"]) == ("start_failed", "gate")


def test_a_death_that_can_not_be_collected_yet_holds_nobody_up(scene: Scene) -> None:
    """As while a debugger holds the dead process; here it has not even died, and its pidfd is said to be ready."""
    family = scene.supervisor.family
    gate = family[layout.GATE]
    pid = os.posix_spawnp("sleep", ["sleep", "120"], os.environ)
    gate.started(pid, 1, scene.now_ns)
    assert gate.life
    scene.supervisor.loop.watch(gate.life.fd, READ)
    family.bury({gate.life.fd: READ}, scene.now_ns, 1)
    assert (gate.pid, gate.restart_ns) == (pid, None)
    os.kill(pid, signal.SIGKILL)
    assert gate.life.wait(20.0)
    assert gate.life.fd not in scene.supervisor.loop.wait(0), "it would wake the supervisor without end"
    family.bury({}, scene.now_ns, 1)
    assert (gate.pid, gate.life, gate.last_exit, gate.state()) == (0, None, "killed by SIGKILL", "waiting")


def test_a_process_that_is_ended_is_collected(scene: Scene) -> None:
    gate = scene.supervisor.family[layout.GATE]
    pid = os.posix_spawnp("sleep", ["sleep", "120"], os.environ)
    gate.started(pid, 1, scene.now_ns)
    gate.kill(20.0)
    assert (gate.pid, gate.life) == (0, None)
    assert not os.path.exists(f"/proc/{pid}")
    gate.kill(20.0)

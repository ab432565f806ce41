"""The family when the machine is short of something: no process that nobody watches, and it is tried again."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

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

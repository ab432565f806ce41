"""The stop test tells what went wrong with it: a latch that it could not clear, a burst that was not written."""

from __future__ import annotations

import os

import pytest

from failstop.doctor import stop_test
from failstop.errors import FailstopError
from failstop.robot import Robot
from failstop.supervisor.port import OwnPort
from failstop.trial import Trial
from tests.procs.parts import new_pty


def test_a_latch_that_the_test_could_not_clear_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Robot) -> str:
        raise FailstopError("no right")

    with Trial(f"doctor-{os.getpid()}-latch") as trial, monkeypatch.context() as patch:
        patch.setattr(Robot, "reset", refuse)
        (found,) = stop_test.by_service(trial.name)
    assert found.problem == "the stop of the test stays latched (no right): failstop reset"


def test_a_duplicate_that_writes_nothing_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with new_pty() as pty:
        own = OwnPort(pty.slave)
        assert stop_test._on_duplicate(own, pty.link)
        monkeypatch.setattr(OwnPort, "burst", lambda _: False)
        assert not stop_test._on_duplicate(own, pty.link)

"""The stop test tells what went wrong with it: a latch that it could not clear, a burst that was not written."""

from __future__ import annotations

import dataclasses
import os
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.api.state import Stop
from failstop.board.stop_port import StopPort
from failstop.doctor import stop_path
from failstop.doctor.look import FAIL, OK
from failstop.lab.trial import Trial
from failstop.policy import causes
from failstop.supervisor.port import OwnPort
from tests.support.ptys import new_pty
from tests.support.states import stop


def test_a_latch_that_the_test_could_not_clear_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Robot) -> str:
        raise FailstopError("no right")

    with Trial(f"doctor-{os.getpid()}-latch") as trial, monkeypatch.context() as patch:
        patch.setattr(Robot, "reset", refuse)
        (found,) = stop_path.by_service(trial.name, "failstop doctor")
    assert found.level == FAIL
    assert "the stop of the test stays latched (no right): failstop reset" in found.text


def test_a_duplicate_that_writes_nothing_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with new_pty() as pty:
        own = OwnPort(pty.slave)
        assert stop_path.on_duplicate(own)
        monkeypatch.setattr(StopPort, "burst", lambda _: False)
        assert not stop_path.on_duplicate(own)


class Told:
    """A service that has not published its first stop yet when it is asked for the first time."""

    def __init__(self, stops: list[Stop | None]) -> None:
        self._stops = stops

    def __enter__(self) -> Told:
        return self

    def __exit__(self, *_: object) -> None:
        assert len(self._stops) == 1, "it is asked until the answer is there, and not after"

    @property
    def state(self) -> Any:
        return SimpleNamespace(last_stop=self._stops.pop(0) if len(self._stops) > 1 else self._stops[0])

    def estop(self, reason: str) -> None:
        pass

    def reset(self) -> None:
        pass


def test_the_answer_is_waited_for_from_before_the_stop_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = [causes.REQUESTED(words, "failstop doctor", 7) for words in (stop_path.REASON, "another's")]
    ours = dataclasses.replace(stop(asked[0]), written_s=3e-4, acknowledged_s=None)
    stops = [None, stop(asked[1]), ours, dataclasses.replace(ours, acknowledged_s=1.5e-3)]
    monkeypatch.setattr(stop_path, "Robot", lambda *_, **__: Told(stops))
    (found,) = stop_path.by_service("any", "failstop doctor")
    assert (found.level, found.text) == (OK, f"{stop_path.REQUEST}: acknowledged by the board after 1.5 ms")

"""The page's watcher: what it shows at once, and what may wait. The state and the times are given."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.api.state import State
from failstop.web import watcher
from failstop.web.watcher import PERIOD_S, Watcher
from tests.support import states


class Follower:
    """A service whose state is what a test says."""

    note, absent, events = "", False, ()

    def __init__(self) -> None:
        self.state = states.latched()

    def read(self, _now_s: float) -> State:
        return self.state


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Follower:
    made = Follower()
    monkeypatch.setattr(watcher, "Follower", lambda _name: made)
    return made


def test_wheels_that_begin_to_turn_are_shown_at_once(service: Follower) -> None:
    found = Watcher("failstop")
    words = []
    for look, turning in enumerate((states.STILL, states.TURNS, states.TURNS_ON, states.STILL)):
        service.state = dataclasses.replace(service.state, turning=turning)
        found.look(look * PERIOD_S, states.NOW_S + look * PERIOD_S)
        words.append(found.shown["word"])
    assert words == ["STOPPED", "STOPPING", "WHEELS TURN", "STOPPED"]

"""Following a service through its restarts."""

from __future__ import annotations

import os

import pytest

from failstop.api.errors import NoService
from failstop.cli.screen.follow import CHECK_S, Follower
from failstop.lab.trial import Trial
from failstop.shm import layout


def test_a_restart_between_two_looks_is_noticed() -> None:
    """The new run is there at the next look, and the memory of the old one can still be read."""
    with Trial(f"screen-{os.getpid()}-fast") as own:
        follower = Follower(own.name)
        before = follower.read(0.0)
        assert before is not None
        own.leave()
        own.service.end()
        own.service.start()
        after = follower.read(CHECK_S)
        assert after is not None
        assert after.processes[layout.SUPERVISOR].pid == own.service.pids()[layout.SUPERVISOR]
        assert after.processes[layout.SUPERVISOR].pid != before.processes[layout.SUPERVISOR].pid


def test_a_service_that_has_gone_is_said() -> None:
    with Trial(f"screen-{os.getpid()}-gone") as own:
        follower = Follower(own.name)
        own.leave()
        own.service.end()
        assert follower.read(10.0) is None
        assert "no service named" in follower.note


def test_there_must_be_one_at_first() -> None:
    with pytest.raises(NoService):
        Follower("nobody-here")

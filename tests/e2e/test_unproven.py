"""A board that has never answered, on the running service: no screen says of it what nothing proves."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator

import pytest

from failstop.lab.trial import Trial, wait_for
from failstop.web import face
from tests.support.commands import failstop

UNPROVEN = "unproven: the board has never answered"


@pytest.fixture
def mute(name: str) -> Iterator[Trial]:
    """A service whose board hears and says nothing of it."""
    trial = Trial(name)
    with contextlib.closing(trial):
        trial.board.start()
        trial.board.deaf(True)
        trial.service.start()
        yield trial


def test_every_screen_says_that_nothing_proves_the_stop(mute: Trial) -> None:
    status = failstop("status", "--name", mute.name).stdout
    assert status.splitlines()[0].startswith(f"wheels    STOPPED, {UNPROVEN}")
    why = json.loads(failstop("why", "--json", "--name", mute.name).stdout)
    assert why["what"].startswith(f"STOPPED, {UNPROVEN}; motion is disabled")
    shown = face.face(mute.robot.state, [], 0.0)
    assert (shown["word"], shown["role"]) == ("STOPPED, UNPROVEN", "bad")
    enabled = failstop("enable", "--name", mute.name)
    assert (enabled.returncode, enabled.stdout) == (0, "motion enabled\n")
    assert enabled.stderr.startswith(f"failstop: {UNPROVEN}, so no stop is known to reach the wheels")


def test_its_first_answer_ends_that(mute: Trial) -> None:
    mute.board.deaf(False)
    wait_for("an answer", lambda: mute.robot.state.device.link == "alive")
    assert failstop("status", "--name", mute.name).stdout.startswith("wheels    STOPPED  ")
    assert failstop("enable", "--name", mute.name).stderr == ""

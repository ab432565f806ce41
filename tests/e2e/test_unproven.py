"""A board that has never answered: no screen says of it what nothing proves."""

from __future__ import annotations

import pytest

from tests.support.simulated import Simulated

UNPROVEN = "unproven: the board has never answered"


@pytest.fixture
def mute() -> Simulated:
    """A service whose board hears nothing and says nothing of it."""
    return Simulated(deaf=True)


def test_every_screen_says_that_nothing_proves_the_stop(mute: Simulated) -> None:
    assert mute.printed("status").startswith(f"wheels STOPPED, {UNPROVEN}")
    assert mute.json("why")["what"].startswith(f"STOPPED, {UNPROVEN}; motion is disabled")
    shown = mute.load("failstop.web.view").view(mute.robot.state, [], 0.0)
    assert (shown["word"], shown["role"]) == ("STOPPED, UNPROVEN", "bad")
    code, out, err = mute.command("enable")
    assert (code, out) == (0, "motion enabled\n")
    assert err.startswith(f"failstop: {UNPROVEN}, so no stop is known to reach the wheels")


def test_its_first_answer_ends_that(mute: Simulated) -> None:
    mute.board.deaf(False)
    mute.wait_for("an answer", lambda: mute.robot.state.device.link == "alive")
    assert mute.command("status")[1].startswith("wheels    STOPPED  ")
    assert mute.command("enable")[2] == ""


def test_its_end_is_no_error(mute: Simulated) -> None:
    """A board without pings is such a one, or one with another firmware."""
    assert mute.end() == 0
    assert "whether the board hears is not known (link unproven)" in mute.said

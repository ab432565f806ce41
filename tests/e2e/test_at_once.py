"""The gate acts at once on a new command and on a stop, not at its next tick: with the slowest tick that is allowed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

from failstop.lab.trial import Trial, wait_for

TRIES = 20
SOON_NS = 10_000_000
MOST_OF_THEM = 13
"""Acting at ticks alone, each try has a chance of 10 ms in 50 ms to be soon: 13 of 20 have one of 1 in 70,000. A busy
machine makes a few late that are not."""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    config = tmp_path_factory.mktemp("slow") / "slow.toml"
    config.write_text("[gate]\nperiod_s = 0.05\n")
    with Trial(f"e2e-{os.getpid()}-slow", ("--config", str(config))) as running:
        yield running


def waits(slow: Trial) -> bool:
    """Enabled, and without a command. A machine that withholds a process for long has it stopped: then once more."""
    state = slow.robot.state
    if state.estop:
        slow.enable()
    return state.blocked == "cmd timeout"


def test_on_a_new_command(slow: Trial) -> None:
    slow.enable()
    soon = 0
    for _ in range(TRIES):
        wait_for("the wheels to be blocked", lambda: waits(slow))
        slow.board.wait_wheels(moving=False, timeout_s=2.0)
        slow.board.events()
        sent_ns = time.monotonic_ns()
        slow.robot.drive(0.2, 0.0, 0.0, manual=True)
        event = slow.board.wait_for(lambda e: e.is_motion, 2.0)
        soon += event.arrival_ns - sent_ns < SOON_NS
    assert soon >= MOST_OF_THEM


def test_on_a_stop_that_the_gate_makes_itself(slow: Trial) -> None:
    soon = 0
    for _ in range(TRIES):
        slow.enable()
        slow.drive(0.06)
        slow.board.wait_wheels(moving=True, timeout_s=2.0)
        slow.board.events()
        sent_ns = time.monotonic_ns()
        slow.robot._client().command(float("nan"), 0.0, 0.0, manual=False, source="cmd_vel")
        event = slow.board.wait_for(lambda e, sent_ns=sent_ns: e.is_stop and e.arrival_ns > sent_ns, 2.0)  # type: ignore[misc]
        soon += event.arrival_ns - sent_ns < SOON_NS
        wait_for("the latch", lambda: slow.robot.state.estop is not None)
    assert soon >= MOST_OF_THEM

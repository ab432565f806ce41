"""The proofs of a stop, by what each board can give: its answer or its echo, and its own reports of the wheels."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from failstop.board.interface import BY_ANSWER, BY_ECHO, BY_IMU, BY_WHEELS
from failstop.board.kinds import KINDS, board_of
from failstop.board.ugv.wire import WATCHDOG_NS
from failstop.cli.main import main
from failstop.policy.layouts import BOARDS
from failstop.policy.proofs import ACKNOWLEDGED_BY, NEVER_SEEN, SEEN_BY
from failstop_lab.trial import Trial, wait_for

ANSWER, ECHO = ("arduino", "damiao", "ugv", "vesc", "rrc"), ("feetech", "hoverboard")
HEARD = dict.fromkeys(ANSWER, BY_ANSWER) | dict.fromkeys(ECHO, BY_ECHO)


@pytest.fixture(scope="module")
def trial_of() -> Iterator[Callable[[str], Trial]]:
    """A service on a board of each kind, started once: a board may be deaf for seconds then."""
    with contextlib.ExitStack() as stack:
        yield functools.cache(lambda kind: stack.enter_context(Trial(f"proofs-{kind}-{os.getpid()}", kind=kind)))


def test_every_board_says_what_can_prove_its_stop() -> None:
    for kind in BOARDS:
        board = board_of(kind, 0.08, 0.0)
        assert board.acknowledged_by == HEARD[kind]
        assert board.observed_by == (BY_WHEELS if kind in KINDS else BY_IMU)
        assert board.observed_by in SEEN_BY.keys() & NEVER_SEEN.keys()
        assert board.acknowledged_by in ACKNOWLEDGED_BY


@pytest.mark.claim("PROOF-1")
@pytest.mark.starts
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_why_names_what_has_proved_the_stop(trial_of: Callable[[str], Trial], kind: str) -> None:
    trial = trial_of(kind)
    trial.enable()
    trial.drive(0.3)
    assert trial.turning()
    trial.robot.estop("hand near wheel")

    def proved() -> bool:
        stop = trial.robot.state.last_stop
        return bool(stop and stop.acknowledged_s is not None and stop.observed_s is not None)

    wait_for("the proofs", proved)
    told = str(trial.robot.why())
    assert f"acknowledged by {ACKNOWLEDGED_BY[HEARD[kind]]} after" in told
    assert "IMU" not in told
    assert "wheels still after" in told


@pytest.mark.claim("WATCHDOG-1")
@pytest.mark.starts
@pytest.mark.slow
def test_status_tells_of_the_boards_own_watchdog(
    trial_of: Callable[[str], Trial], capsys: pytest.CaptureFixture[str]
) -> None:
    """As it was set at the opening of the port."""
    trial = trial_of("ugv")
    assert main(["status", "--name", trial.name]) == 0
    assert "without a host it stops its wheels after 0.5 s" in " ".join(capsys.readouterr().out.split())
    assert trial.robot.state.device.watchdog_s == WATCHDOG_NS / 1e9


@pytest.mark.claim("WATCHDOG-1")
@pytest.mark.starts
@pytest.mark.slow
def test_the_boards_own_watchdog_stops_the_wheels_when_everything_is_frozen(trial_of: Callable[[str], Trial]) -> None:
    """All of the service stands at once, as with a kernel that is dead: nobody writes, and the board's receiver ends
    the motion itself, within what was set."""
    trial = trial_of("ugv")
    trial.enable()
    trial.drive(0.3)
    pids = trial.service.pids().values()
    try:
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        wrote_ns = max(event.arrival_ns for event in trial.board.events() if event.is_motor)
        wait_for("its wheels to stand", lambda: not any(trial.board.wheels()))
        after_s = (time.monotonic_ns() - wrote_ns) / 1e9
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
    assert after_s > 0.9 * WATCHDOG_NS / 1e9, "the watchdog, and nobody before it"
    assert not any(
        event.is_stop for event in trial.board.events() if wrote_ns < event.arrival_ns < wrote_ns + WATCHDOG_NS
    )

"""The proofs of a stop, by what each board can give: its answer or its echo, and its own reports of the wheels."""

from __future__ import annotations

import os

import pytest

from failstop.board.interface import BY_ANSWER, BY_ECHO, BY_IMU, BY_WHEELS
from failstop.board.kinds import KINDS, board_of
from failstop.lab.trial import Trial, wait_for
from failstop.policy.proofs import ACKNOWLEDGED_BY, NEVER_SEEN, SEEN_BY
from failstop.policy.settings import BOARDS

HEARD = {"arduino": BY_ANSWER, "hoverboard": BY_ECHO, "ugv": BY_ANSWER, "rrc": BY_ANSWER}


def test_every_board_says_what_can_prove_its_stop() -> None:
    for kind in BOARDS:
        board = board_of(kind, 0.08, 0.0)
        assert board.acknowledged_by == HEARD[kind]
        assert board.observed_by == (BY_WHEELS if kind in KINDS else BY_IMU)
        assert board.observed_by in SEEN_BY.keys() & NEVER_SEEN.keys()
        assert board.acknowledged_by in ACKNOWLEDGED_BY


@pytest.mark.starts
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_why_names_what_has_proved_the_stop(kind: str) -> None:
    with Trial(f"proofs-{os.getpid()}", kind=kind) as trial:
        trial.enable()
        trial.drive(0.3)
        assert trial.moving()
        trial.robot.estop("hand near wheel")

        def proved() -> bool:
            stop = trial.robot.state.last_stop
            return bool(stop and stop.acknowledged_s is not None and stop.observed_s is not None)

        wait_for("the proofs", proved)
        told = str(trial.robot.why())
        assert f"acknowledged by {ACKNOWLEDGED_BY[HEARD[kind]]} after" in told
        assert "IMU" not in told
        assert "wheels still after" in told

"""A trial whose service does not end in order: whatever else it started is ended all the same."""

from __future__ import annotations

import os
import signal

import pytest

from failstop_lab.trial import Service, Trial, TrialError


class Stubborn(Service):
    """A service that has to be killed."""

    def end(self) -> int:
        self.kill()
        raise TrialError("it did not end")


def test_what_does_not_end_leaves_nothing_of_the_rest_behind() -> None:
    trial = Trial(f"trial-end-{os.getpid()}")
    trial.service.close()
    trial.service = Stubborn(trial.name, trial.link, trial.state)
    trial.__enter__()
    board = trial.board.pid
    with pytest.raises(TrialError, match="it did not end"):
        trial.close()
    assert not os.path.exists(os.path.dirname(trial.link)), "its folder is gone"
    assert not [file for file in os.listdir("/dev/shm") if file.startswith(f"failstop.{trial.name}.")]
    with pytest.raises(ProcessLookupError):
        os.kill(board, signal.SIGCONT)

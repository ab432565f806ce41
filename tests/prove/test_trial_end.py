"""A trial whose service does not end in order: whatever else it started is ended all the same."""

from __future__ import annotations

import os
import signal

import pytest

from failstop.lab.trial import Trial, TrialError


def test_what_does_not_end_leaves_nothing_of_the_rest_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(f"trial-end-{os.getpid()}")

    def end() -> int:
        trial.service.kill()
        raise TrialError("it did not end")

    trial.__enter__()
    board = trial.board.pid
    monkeypatch.setattr(trial.service, "end", end)
    with pytest.raises(TrialError, match="it did not end"):
        trial.close()
    assert not os.path.exists(os.path.dirname(trial.link)), "its folder is gone"
    assert not [file for file in os.listdir("/dev/shm") if file.startswith(f"failstop.{trial.name}.")]
    with pytest.raises(ProcessLookupError):
        os.kill(board, signal.SIGCONT)

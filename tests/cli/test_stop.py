"""`failstop stop --services`: the exit code says whether every robot was stopped beyond doubt."""

from __future__ import annotations

import pytest

from failstop import instances
from failstop.api import ask
from failstop.cli.commands import stop

STOPPED = ("'a': the stop is acknowledged", "", False)
DOUBTED = ("'b': the stop is written", "the board does not answer: use the POWER SWITCH", True)
SILENT = ("", "'c' does not answer", False)


@pytest.mark.parametrize(
    ("answers", "code"),
    [([STOPPED], 0), ([STOPPED, DOUBTED], 1), ([STOPPED, SILENT], 1), ([], 0)],
    ids=["all sure", "one in doubt", "one not written", "none runs"],
)
def test_a_stop_of_which_one_robot_is_in_doubt_is_no_success(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answers: list[tuple[str, str, bool]],
    code: int,
) -> None:
    """The unit failstop-sleep.service runs it before the machine is suspended."""
    monkeypatch.setattr(instances, "listening", lambda: [str(at) for at in range(len(answers))])
    monkeypatch.setattr(ask, "stop", lambda name, _reason, _who: answers[int(name)])
    assert stop._every_service("hand near wheel", "failstop stop") == code
    said = capsys.readouterr()
    for done, problem, _doubt in answers:
        assert done in said.out
        assert problem in said.err

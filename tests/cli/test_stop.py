"""`failstop stop --services`: the exit code says whether every robot was stopped beyond doubt."""

from __future__ import annotations

from argparse import Namespace

import pytest

from failstop import instances
from failstop.api import ask
from failstop.cli.commands import stop

STOPPED = ("'a': the stop is acknowledged", "", False)
DOUBTED = ("'b': the stop is written", "the board does not answer: use the POWER SWITCH", True)
ELSEWHERE = "no service 'right' runs, and 'left' has /dev/ttyACM0 now, the port of its last run"
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


@pytest.mark.parametrize("last", [False, True], ids=["a port that is only the default", "the port of the last run"])
def test_the_stop_of_another_service_at_a_port_that_is_a_guess_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], last: bool
) -> None:
    """The robot that was meant may be at another port, and its wheels may turn."""
    target = stop.Target(Namespace(device=None, wait=None, name="right", config=None))
    monkeypatch.setattr(stop.Target, "_is_last", lambda _: last)
    monkeypatch.setattr(stop.Target, "_file", {})
    monkeypatch.setattr(stop.Target, "device", lambda _: "/dev/ttyACM0")
    monkeypatch.setattr(instances, "listens", lambda _: False)
    monkeypatch.setattr(instances, "listening", lambda: ["left"])
    monkeypatch.setattr(ask, "port_of", lambda _: "/dev/ttyACM0")
    monkeypatch.setattr(ask, "stop", lambda *_: STOPPED)
    assert stop._ask_services(stop.Order("right", "", "failstop stop", target)) == 1
    said = capsys.readouterr()
    assert STOPPED[0] in said.out
    assert (ELSEWHERE if last else "the stop went to /dev/ttyACM0, the default") in said.err

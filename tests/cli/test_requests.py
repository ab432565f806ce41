"""`failstop enable`, `limit`, `drive` and `arm`: what is refused before it is asked for, and how far a request is."""

from __future__ import annotations

import os

import pytest

from failstop.cli import main as cli
from failstop.cli.commands.requests import ALLOWED_PERCENT
from failstop.cli.screen.progress import Progress
from failstop.procs.gate.core import LEAST_LIMIT
from failstop_lab.faults.arm import ArmTrial
from failstop_lab.trial import Trial
from tests.support.commands import FAILSTOP
from tests.support.typist import Typist


@pytest.mark.parametrize(
    "words",
    ["drive 0.1 0 0 --for", "arm jog base=0.1 --for", "arm move base=0.1 --over", "incident plot last --seconds"],
)
@pytest.mark.parametrize("time", ["-1", "0", "nan", "inf", "soon"])
def test_what_is_no_time_is_refused_with_a_sentence(words: str, time: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*words.split(), time]) == 1
    sentence = f"{time} is no time in seconds: give a number above 0, such as 2"
    assert sentence in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("slow", ["-1e-1", "-.1", "-0.1"])
def test_a_negative_speed_is_no_option_however_it_is_written(slow: str) -> None:
    found = cli.load("drive")[0].parse_args(["1e-1", "0", slow])
    assert (found.vx, found.vy, found.wz) == (0.1, 0.0, -0.1)


@pytest.mark.parametrize("percent", ["0", "-5", "3", "101", "nan"])
def test_a_limit_that_is_none_is_refused(trial: Trial, percent: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["limit", percent, "--name", trial.name]) == 2
    assert capsys.readouterr().err == f"failstop: refused: a speed limit of {percent} %: must be 5 to 100\n"


def test_a_limit_of_no_number_prints_the_one_in_force(trial: Trial, capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for words in ([], ["30"], [], ["100"], []):
        assert cli.main(["limit", *words, "--name", trial.name]) == 0
        said.append(capsys.readouterr().out.strip())
    limited = "speed limited to 30 % of the settings'"
    unlimited = "no speed limit is set (100 %)"
    assert said == [unlimited, limited, limited, "speed limit lifted", unlimited]


def test_the_limits_of_the_limit_are_the_gate_s() -> None:
    assert f"{LEAST_LIMIT} to 100" == ALLOWED_PERCENT


@pytest.mark.parametrize(("term", "tty"), [("xterm", False), ("dumb", True)])
def test_progress_is_for_a_terminal_alone(
    term: str, tty: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", term)
    monkeypatch.setattr("sys.stdout.isatty", lambda: tty)
    with Progress() as progress:
        progress("on its way, 1.0 s left")
    assert capsys.readouterr().out == ""


def test_progress_is_one_line_and_goes(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    with Progress() as progress:
        progress("on its way, 10 s left")
        progress("settling")
    assert capsys.readouterr().out.split("\r") == ["", "on its way, 10 s left", "settling" + 13 * " ", 8 * " ", ""]


def test_enabling_with_an_arm_is_one_line() -> None:
    with ArmTrial(f"arm-{os.getpid()}") as trial, Typist([*FAILSTOP, "enable", "--name", trial.name]) as typist:
        assert typist.end() == 0
        assert "s left" in typist.raw, "how far it is"
        assert "motion enabled" in typist.raw
        assert "s left" not in typist.raw.rstrip().rpartition("\r")[2], "gone at the end"
        assert typist.raw.count("\n") == 1

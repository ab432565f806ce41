"""The demo's kills; test_package.py runs all of it."""

from __future__ import annotations

import pytest

from failstop.messages import layout
from failstop_lab.commands import demo
from failstop_lab.trial import Stopped, Trial


class Busy:
    """A trial on a machine on which so many kills find a robot that was stopped before."""

    name = "busy"

    def __init__(self, times: int) -> None:
        self.left = times
        self.robot = self
        self.state = self
        self.estop = "gate hangs: 61 ms silent"

    def enable(self) -> None:
        """Nothing to enable."""

    leave = enable
    service = property(lambda self: self)

    def pids(self) -> dict[str, int]:
        return dict.fromkeys(layout.PROCESS_NAMES, 1)

    def kill(self, _process: str, _drive_s: float) -> Stopped:
        self.left -= 1
        return Stopped(0, 500_000, 550_000, 600_000, 0, was_turning=self.left < 0)

    def recover(self, _process: str, _pid: int) -> float:
        return 0.1


@pytest.mark.parametrize("times", [0, 1, 2, 3])
def test_a_kill_that_came_after_a_stop_is_done_again(times: int, capsys: pytest.CaptureFixture[str]) -> None:
    row = demo._kill(Busy(times), "gate", 0.2)  # type: ignore[arg-type]
    said = capsys.readouterr().out
    assert said.count("kill -9 gate") == min(times + 1, 3)
    why = "the wheels were not turning (latched: gate hangs: 61 ms silent), so this kill shows nothing"
    assert said.count(why) == times
    assert row.fault() == ("the wheels were not turning" if times == 3 else "")


@pytest.mark.slow
def test_with_the_plug_out_no_kill_counts_as_answered(capsys: pytest.CaptureFixture[str]) -> None:
    with Trial() as trial:
        trial.enable()
        trial.drive(0.5)
        assert trial.turning()
        trial.board.unplug()
        row = demo.Row("gate", trial.kill("gate", 0.1))
    assert demo.judged([row], 0, "") == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "FAILED: NO STOP" in said
    assert "Every kill led to a stop" not in said


def test_the_words_of_a_service_that_fails_at_its_end_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    row = demo.Row("gate", Stopped(0, 500_000, 550_000, 600_000, 0, was_turning=True))
    words = "failstop: the board did not answer the last stop"
    assert demo.judged([row], 0, words) == 0
    assert words not in capsys.readouterr().out
    assert demo.judged([row], 1, words) == 1
    assert words in capsys.readouterr().out

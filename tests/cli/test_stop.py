"""`failstop stop`: its priority; and of `--services`, that the exit code says whether every robot was stopped beyond
doubt."""

from __future__ import annotations

import os
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from subprocess import PIPE

import pytest

from failstop import instances, stop_tool
from failstop.api import ask
from failstop.board import kept
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.cli import main as cli
from failstop.cli.commands import stop
from failstop.cli.target import DEVICE, Target
from failstop.files import instance
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs import rights
from failstop_lab.trial import wait_for
from tests.support.commands import FAILSTOP

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
    target = Target(Namespace(device=None, wait=None, name="right", config=None))
    monkeypatch.setattr(Target, "_is_last", lambda _: last)
    monkeypatch.setattr(Target, "_file", {})
    monkeypatch.setattr(Target, "device", lambda _: "/dev/ttyACM0")
    monkeypatch.setattr(instances, "listens", lambda _: False)
    monkeypatch.setattr(instances, "listening", lambda: ["left"])
    monkeypatch.setattr(ask, "port_of", lambda _: "/dev/ttyACM0")
    monkeypatch.setattr(ask, "stop", lambda *_: STOPPED)
    assert stop._ask_services(stop.Order("right", "", "failstop stop", target)) == 1
    said = capsys.readouterr()
    assert STOPPED[0] in said.out
    assert (ELSEWHERE if last else "the stop went to /dev/ttyACM0, the default") in said.err


@pytest.mark.parametrize(("port", "asks"), [("/dev/ttyACM0", False), ("/dev/ttyACM1", True)])
@pytest.mark.parametrize("there", [True, False, None])
def test_for_systemd_only_the_service_that_has_the_dead_run_s_board_is_asked(
    monkeypatch: pytest.MonkeyPatch, port: str, asks: bool, there: bool | None
) -> None:
    """The settings' port may be a healthy robot's by now, whose service would stop it instead."""
    target = Target(Namespace(device=None, wait=None, name="right", config="its.toml"), last_first=True)
    monkeypatch.setattr(Target, "_file", {DEVICE: "/dev/ttyACM0"})
    monkeypatch.setattr(Target, "_last", instance.Last("/dev/ttyACM1"))
    monkeypatch.setattr(Target, "_is_at_last_port", lambda _: there)
    monkeypatch.setattr(instances, "listening", lambda: ["left"])
    monkeypatch.setattr(ask, "port_of", lambda _: port)
    asked: list[str] = []

    def answer(name: str, *_: str) -> tuple[str, str, bool]:
        asked.append(name)
        return STOPPED

    monkeypatch.setattr(ask, "stop", answer)
    outcome = stop._ask_services(stop.Order("right", "", "failstop stop", target))
    assert (outcome, asked) == ((0, ["left"]) if asks and there else ("", []))


@pytest.mark.parametrize(
    ("name", "started_with", "its", "asked", "outcome"),
    [
        ("right", "its.toml", "/dev/ttyACM1", ["right"], 0),
        ("right", "another.toml", "/dev/ttyACM0", ["right"], 0),
        ("right", "another.toml", "/dev/ttyACM1", ["right"], ""),
        ("left", "its.toml", "/dev/ttyACM1", ["left"], 0),
        ("left", "another.toml", "/dev/ttyACM1", [], ""),
    ],
    ids=["its file", "its port", "neither", "another service of the file", "a stranger"],
)
@pytest.mark.parametrize("doubt", [False, True])
def test_a_file_says_which_robot_is_meant_wherever_its_board_is(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    name: str,
    started_with: str,
    its: str,
    asked: list[str],
    outcome: int | str,
    doubt: bool,
) -> None:
    """The service `right` is meant, and only `name` runs. If the port in the file may be another robot's, the stop goes
    there too."""
    for file in ("its.toml", "another.toml"):
        (tmp_path / file).write_text('device.path = "/dev/ttyACM0"\n')
    target = Target(Namespace(device=None, wait=None, name="right", config=str(tmp_path / "its.toml")))
    runs = f"failstop run --name {name} --config {tmp_path / started_with} --device {its}"
    monkeypatch.setattr(instance, "last", lambda of: instance.Last(its, runs if of == name else ""))
    monkeypatch.setattr(instances, "listens", lambda of: of == name)
    monkeypatch.setattr(instances, "listening", lambda: [name])
    monkeypatch.setattr(ask, "port_of", lambda _: its)
    were: list[str] = []

    def answer(of: str, *_: str) -> tuple[str, str, bool]:
        were.append(of)
        return DOUBTED if doubt else STOPPED

    monkeypatch.setattr(ask, "stop", answer)
    found = stop._ask_services(stop.Order("right", "", "failstop stop", target))
    assert (found, were) == (int(doubt) if outcome == 0 else outcome, asked)
    assert target.unproved == (doubt and bool(asked)), "the exit code counts it, whatever is written after it"


def test_a_service_of_the_file_that_does_not_answer_is_written_past_at_its_own_port(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "its.toml"
    file.write_text('device.path = "/dev/ttyACM0"\n')
    target = Target(Namespace(device=None, wait=None, name="right", config=str(file)))
    monkeypatch.setattr(instance, "last", lambda _: instance.Last("/dev/ttyACM1", f"failstop run --config {file}"))
    monkeypatch.setattr(instances, "listens", lambda _: True)
    monkeypatch.setattr(instances, "listening", lambda: ["right"])
    monkeypatch.setattr(ask, "port_of", lambda _: "/dev/ttyACM1")
    monkeypatch.setattr(ask, "owner_of", lambda _: 0)
    monkeypatch.setattr(ask, "stop", lambda *_: SILENT)
    assert stop._ask_services(stop.Order("right", "", "failstop stop", target)) == SILENT[1]
    assert target.device() == "/dev/ttyACM1"


@pytest.mark.parametrize(
    ("port", "there", "its"),
    [
        ("/dev/left", True, "left"),
        ("/dev/left", None, "left"),
        ("/dev/left", False, "right"),
        ("/dev/right", True, "right"),
    ],
    ids=["its port", "its port, perhaps", "another device at its port", "another port"],
)
def test_the_kept_stop_is_for_the_board_of_the_last_run_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, port: str, there: bool | None, its: str
) -> None:
    """Two boards of one kind may have different motors."""
    left, right = (board_of("vesc", 1.0, 0.0, can_id=number) for number in (20, 10))
    file = tmp_path / "right.toml"
    file.write_text(f'device.path = "{port}"\nboard.kind = "vesc"\nboard.can_id = 10\n')
    monkeypatch.setattr(Target, "_last", instance.Last("/dev/left", "", (), "vesc", kept.pack_stop(left)))
    monkeypatch.setattr(Target, "_is_at_last_port", lambda _: there)
    target = Target(Namespace(device=None, wait=None, name="failstop", config=str(file)))
    assert target.device() == port
    assert left.burst != right.burst
    assert target.board().burst == (left if its == "left" else right).burst


def test_the_stop_at_the_settings_port_is_for_the_settings_board(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With --last-port, after the one at the port of the last run."""
    left, right = (board_of("vesc", 1.0, 0.0, can_id=number) for number in (20, 10))
    file = tmp_path / "right.toml"
    file.write_text('device.path = "/dev/right"\nboard.kind = "vesc"\nboard.can_id = 10\n')
    monkeypatch.setattr(Target, "_last", instance.Last("/dev/left", "", (), "vesc", kept.pack_stop(left)))
    monkeypatch.setattr(Target, "_is_at_last_port", lambda _: True)
    monkeypatch.setattr(Target, "_is_usable", lambda _: False)
    wrote: list[tuple[str, bytes]] = []

    def write(path: str, board: Board, *_: object, **__: object) -> bool:
        wrote.append((path, board.burst))
        return False

    monkeypatch.setattr(stop_tool, "write", write)
    target = Target(Namespace(device=None, wait=None, name="failstop", config=str(file)), last_first=True)
    target.stop()
    assert target.missed() is False
    assert wrote == [("/dev/left", left.burst), ("/dev/right", right.burst)]


FORKS = os.SCHED_RESET_ON_FORK


def may_be_realtime() -> bool:
    """Whether this user's programs may ask for a real-time priority."""
    with rights.realtime(1) as granted:
        return granted


@pytest.mark.skipif(not may_be_realtime(), reason="without the right to a real-time priority")
def test_a_stop_comes_before_ordinary_programs(tmp_path: Path) -> None:
    """It asks for that before it imports the command, because on a busy computer the imports take longest. What it
    starts has none, and neither has a command that is not a stop."""
    command = [*FAILSTOP, "stop", "--device", str(tmp_path / "gone"), "--wait", "20"]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE) as tool:
        try:
            wait_for("its priority", lambda: os.sched_getscheduler(tool.pid) & ~FORKS == os.SCHED_FIFO)
            assert os.sched_getscheduler(tool.pid) & FORKS
            assert os.sched_getparam(tool.pid).sched_priority < min(row.priority for row in PROCESS_BY_NAME.values())
        finally:
            tool.kill()
    before = os.sched_getscheduler(0)
    assert cli.main(["stop", "--device", str(tmp_path / "gone"), "--wait", "0"]) == 1
    assert os.sched_getscheduler(0) == before, "a program that calls this keeps its own priority"


def test_a_stop_does_without_the_right_to_a_priority(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(sys, "argv", ["failstop", "stop", "--device", str(tmp_path / "gone"), "--wait", "0"])
    assert cli.main() == 1

"""`failstop doctor` as a user runs it: on a simulated board, with a service and without, and with what is wrong."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.board.kinds import KINDS, board_of
from failstop.board.port import open_port
from failstop.board.rrc.board import RRC_PORT
from failstop.cli import style
from failstop.cli.commands.doctor import ARROW, screen
from failstop.cli.main import main
from failstop.doctor.look import LEVELS, SKIP, WARN, Finding
from failstop.incidents import files
from failstop.version import VERSION
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Trial, wait_for

Found = dict[str, list[dict[str, Any]]]
"""Findings by check."""


class Doctor:
    """The command, in this process."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def said(self, *words: str) -> tuple[int, str]:
        code = main(["doctor", "--quick", *words])
        out, errors = self._capsys.readouterr()
        assert errors == ""
        return code, out

    def __call__(self, *words: str) -> tuple[int, Found]:
        code, out = self.said("--json", *words)
        result = json.loads(out)
        found: Found = {}
        for finding in result["findings"]:
            found.setdefault(finding["check"], []).append(finding)
        levels = [finding["level"] for finding in result["findings"]]
        assert result["worst"] == max(levels, key=LEVELS.index)
        assert all(finding.keys() == {"check", "level", "text", "fix", "advice"} for finding in result["findings"])
        assert (code == 1) == (result["worst"] == "fail"), result
        return code, found


@pytest.fixture
def doctor(capsys: pytest.CaptureFixture[str]) -> Doctor:
    return Doctor(capsys)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SimBoard]:
    with SimBoard(tmp_path / "board", imu_hz=0) as running:
        yield running


@pytest.fixture
def name() -> str:
    return f"doctor-{os.getpid()}"


def stop_path(found: Found) -> list[str]:
    return [f"{finding['level']}: {finding['text']}" for finding in found["stop path"]]


def test_every_way_to_the_board_is_acknowledged(doctor: Doctor, board: SimBoard, name: str) -> None:
    _, found = doctor("--device", board.link, "--name", name)
    said = stop_path(found)
    assert [line.partition(": acknowledged")[0] for line in said] == [
        "ok: supervisor's opening",
        "ok: stopper's duplicate",
        "ok: stop tool",
    ]
    assert sum(event.is_stop for event in board.events()) == 12, "three bursts of four stop frames"
    assert not any(event.is_motion for event in board.events(since=0))


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_board_is_known_and_another_told(kind: str, doctor: Doctor, name: str, tmp_path: Path) -> None:
    config = tmp_path / "robot.toml"
    with SimBoard(tmp_path / "board", board=kind) as board:
        config.write_text(f'board.kind = "{kind}"\n')
        _, found = doctor("--config", str(config), "--device", board.link, "--name", name)
        assert found["board"][0]["level"] == "ok", found["board"]
        heard = ": written; the board reports zero speed" if kind == "hoverboard" else ": acknowledged"
        assert [line.partition(heard)[0] for line in stop_path(found)] == [
            "ok: supervisor's opening",
            "ok: stopper's duplicate",
            "ok: stop tool",
        ]
        code, found = doctor("--device", board.link, "--name", name)
        assert not any(event.is_motion for event in board.events())
    assert code == 1
    [told] = found["board"]
    assert told["text"] == f"the board that answers is {kind}, but board.kind is rrc"
    assert told["advice"].startswith(f'set board.kind = "{kind}"')
    assert stop_path(found) == ["skip: not tested, because it may not be the board"]


def test_a_board_that_does_not_hear_is_a_failure(doctor: Doctor, tmp_path: Path, name: str) -> None:
    with SimBoard(tmp_path / "board", imu_hz=20) as board:
        board.deaf(True)
        code, found = doctor("--device", board.link, "--name", name)
    assert code == 1
    [told] = found["board"]
    assert told["text"] == "it reports as rrc does, but answers no question, so it may hear nothing"
    assert stop_path(found) == ["skip: not tested, because it may not be the board"]


def test_a_port_that_somebody_has_open_is_left_alone(doctor: Doctor, board: SimBoard, name: str) -> None:
    fd = open_port(board.link, exclusive=False, line=RRC_PORT)
    with subprocess.Popen(["sleep", "60"], pass_fds=[fd]) as somebody:
        os.close(fd)
        code, found = doctor("--device", board.link, "--name", name)
        somebody.kill()
    assert code == 1
    assert f"(pid {somebody.pid}) has the port open" in found["holders"][0]["text"]
    assert "has the port open" in stop_path(found)[0]
    assert board.events() == []


def test_settings_that_no_service_would_start_with(doctor: Doctor, board: SimBoard, name: str, tmp_path: Path) -> None:
    config = tmp_path / "mine.toml"
    config.write_text("[gate]\nlease_s = 9.0\n")
    code, found = doctor("--config", str(config), "--device", board.link, "--name", name)
    assert code == 1
    assert "gate.lease_s = 9.0" in found["settings"][0]["text"]
    config.write_text(f'[device]\npath = "{board.link}"\n')
    _, found = doctor("--config", str(config), "--name", name)
    assert found["settings"][0] == {"check": "settings", "level": "ok", "text": str(config), "fix": "", "advice": ""}
    assert board.link in found["port"][0]["text"]


def test_a_running_service_is_looked_at_and_left_alone(doctor: Doctor, name: str) -> None:
    with Trial(name) as trial:
        wait_for("the board's answer", lambda: trial.robot.state.device.link == "alive")
        _, found = doctor("--name", name)
        assert found["service"][0]["level"] == "ok", found["service"]
        assert f"failstop {VERSION}), " in found["service"][0]["text"]
        assert trial.link in found["port"][0]["text"]
        assert found["holders"][0]["level"] == "ok", found["holders"]
        assert trial.robot.state.last_stop is None
        assert found["board"][0]["text"].startswith("it answers the service's questions as rrc does")
        assert stop_path(found) == ["skip: this run of the service has had no stop yet"]

        trial.enable()
        trial.robot.estop("smoke")
        wait_for("the board's answer", lambda: getattr(trial.robot.state.last_stop, "acknowledged_s", None) is not None)
        _, found = doctor("--name", name)
        assert stop_path(found)[0].startswith("ok: the service's last stop: acknowledged by the board after")
        assert (trial.robot.state.estop or "").startswith("stop request: smoke"), "the latch stays"


def test_a_suspended_supervisor_is_found(doctor: Doctor, name: str) -> None:
    with Trial(name) as trial:
        pid = trial.service.pids()["supervisor"]
        os.kill(pid, signal.SIGSTOP)
        try:
            wait_for("its silence", lambda: trial.robot.state.processes["supervisor"].state == "suspended")
            code, found = doctor("--name", name)
        finally:
            os.kill(pid, signal.SIGCONT)
        trial.leave()
    assert code == 1
    assert found["service"][0]["text"].startswith(f"supervisor (pid {pid}) is suspended")
    assert found["service"][0]["fix"] == f"sudo kill -CONT {pid}"
    assert "ok" not in [row["level"] for row in found["service"]]


def test_a_report_is_one_file_without_a_secret(
    doctor: Doctor, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report, config = tmp_path / "report.json", tmp_path / "mine.toml"
    config.write_text("still.command = 'true \"hunter2\"'\n")
    with Trial(name, ("--config", str(config))) as trial:
        monkeypatch.setenv("STATE_DIRECTORY", trial.state)
        trial.enable()
        trial.robot.estop("smoke")
        wait_for("the stop's file", lambda: bool(files.heads(name, files.folders(name, os.environ))[0]))
        doctor.said("--name", name, "--report", str(report))
    told = json.loads(text := report.read_text())
    assert told["version"] == VERSION
    assert told["packages"]["msgpack"]
    assert told["settings"]["gate.lease_s"] == float(told["incident"]["settings"]["gate.lease_s"])
    assert told["incident"]["reason"].startswith("stop request: smoke")
    assert told["settings"]["still.command"] == told["incident"]["settings"]["still.command"] == "(left out)"
    assert "hunter2" not in text
    assert told["incident"]["host"] == "(left out)"


def test_for_people(doctor: Doctor, board: SimBoard, name: str) -> None:
    _, out = doctor.said("--device", board.link, "--name", name)
    assert "ok    stop path" in out
    assert f"no service named '{name}' is running" in out
    assert out.splitlines()[-1].endswith(" fine")
    assert "\x1b" not in out


def test_at_80_columns_no_word_is_cut_and_every_command_is_whole() -> None:
    tee = "echo 'anna - memlock unlimited' | sudo tee -a /etc/security/limits.d/failstop.conf"
    found = [
        ("memory lock", Finding(WARN, "word " * 40, tee, "advice " * 20)),
        ("stop path", Finding(SKIP, "short", "failstop doctor")),
    ]
    lines = [style.plain(line) for line in screen(found, 80)]
    [pasted] = [line for line in lines if tee in line]
    assert pasted.strip() == ARROW + tee
    assert max(map(len, (line for line in lines if line != pasted))) <= 80
    assert {word for line in lines for word in line.split()} >= {"word", "advice"}
    assert lines[-1] == "1 warned, 1 not known"
    assert len(screen(found)) == 7, "a finding is a line where nobody looks at it"


def test_at_80_columns_the_frames_of_a_remedy_are_whole() -> None:
    remedies = [each.remedy for each in board_of("ugv", 1.0, 0.0).commanders]
    frames = [found for remedy in remedies for found in re.findall(r"{\"T\"[^ ;]*}", remedy)]
    shown = screen([("commanders", Finding(WARN, "", "", remedy)) for remedy in remedies], 80)
    lines = [style.plain(line) for line in shown]
    assert len(frames) >= 2
    assert all(any(frame in line for line in lines) for frame in frames)
    assert all(json.loads(frame) for frame in frames)

"""The command that people are told to type for a restart starts the same service again: its file, its port and its
name. What it is otherwise: tests/cli/test_follow.py."""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from failstop import NoService, Robot, instances
from failstop.cli.commands import run
from failstop.supervisor import status
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.support.commands import FAILSTOP, failstop


def ready(name: str, process: subprocess.Popen[bytes]) -> None:
    """Wait until this process's service is whole."""

    def pid() -> int:
        try:
            state = Robot(name).state
        except NoService:
            return 0
        return state.processes["supervisor"].pid if state.waiting_for is None else 0

    wait_for("the service", lambda: pid() == process.pid)


def test_the_command_that_is_told_starts_the_same_service(name: str, tmp_path: Path) -> None:
    """Typed in a shell, in another folder, after a death and after an end in order."""
    folder = tmp_path / "his folder"
    folder.mkdir()
    (folder / "my robot.toml").write_text("[interlocks]\nseat = {}\n[limits]\nvx_mps = 0.11\n")
    expected = f"failstop run --name {name} --config '{folder}/my robot.toml' --device '{folder}/the board'"
    line = expected.replace("failstop", f"exec {sys.executable} -m failstop", 1)
    words = ["run", "--device", "the board", "--config", "my robot.toml", "--name", name]
    with SimBoard(folder / "the board"), contextlib.ExitStack() as started:
        process = subprocess.Popen([*FAILSTOP, *words], cwd=folder, stderr=subprocess.DEVNULL)
        started.callback(process.kill)
        for number in (signal.SIGKILL, signal.SIGTERM):
            ready(name, process)
            robot = started.enter_context(Robot(name))
            assert robot.settings["limits.vx_mps"] == 0.11
            process.send_signal(number)
            process.wait(10.0)
            wait_for("the last process to end", lambda: not instances.listens(name))
            for word in ("why", "status", "reset"):
                done = failstop(word, "--name", name)
                told = re.findall(r"`(failstop run[^`]*)`", " ".join((done.stdout + done.stderr).split()))
                assert told[:1] == [expected], word
            with pytest.raises(NoService, match=re.escape(f"start it with `{expected}`")):
                _ = robot.state
            process = subprocess.Popen(["/bin/sh", "-c", line], cwd=tmp_path, stderr=subprocess.DEVNULL)
            started.callback(process.kill)
        ready(name, process)
        with pytest.raises(Exception, match="seat"):
            robot.enable()
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 0


def test_a_run_of_a_systemd_unit_is_started_again_by_systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cgroup").write_text("0::/system.slice/system-failstop.slice/failstop@left.service\n")
    monkeypatch.setattr(status, "CONTROL_GROUP", str(tmp_path / "cgroup"))
    for name, again in (("left", "sudo systemctl start failstop@left"), ("right", "failstop run --name right")):
        assert run._again(Namespace(name=name, config=None, device=None)) == again

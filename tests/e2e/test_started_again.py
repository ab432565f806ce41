"""The command that people are told to type for a restart starts the same service again: its file, its port and its
name."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import NoService, Robot, instances
from failstop.files import instance
from failstop.lab.sim.client import SimBoard
from failstop.lab.trial import wait_for
from tests.support.commands import FAILSTOP, failstop


class Started:
    """A service that somebody has started by hand, in a folder of his, and the board."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        folder.mkdir()
        (folder / "my robot.toml").write_text("[interlocks]\nseat = {}\n[limits]\nvx_mps = 0.11\n")
        self.board = SimBoard(folder / "the board")
        self.board.__enter__()
        words = ["run", "--device", "the board", "--config", "my robot.toml", "--name", name]
        self.process = subprocess.Popen([*FAILSTOP, *words], cwd=folder, stderr=subprocess.DEVNULL)
        self.expected = f"failstop run --name {name} --config '{folder}/my robot.toml' --device '{folder}/the board'"
        self.ready()

    def ready(self) -> None:
        def pid() -> int:
            try:
                state = Robot(self.name).state
            except NoService:
                return 0
            return state.processes["supervisor"].pid if state.waiting_for is None else 0

        wait_for("the service", lambda: pid() == self.process.pid)

    def type(self, command: str, folder: Path) -> None:
        """Start it by a line in a shell, in another folder."""
        line = command.replace("failstop", f"exec {sys.executable} -m failstop", 1)
        self.process = subprocess.Popen(["/bin/sh", "-c", line], cwd=folder, stderr=subprocess.DEVNULL)
        self.ready()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        wait_for("the last process to end", lambda: not instances.listens(self.name))

    def close(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(10.0)
        self.board.close()


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Started]:
    """Every test leaves it running, by the command that it was told."""
    made = Started(f"e2e-again-{os.getpid()}", tmp_path_factory.mktemp("again") / "his folder")
    yield made
    made.close()


def told(name: str, word: str) -> list[str]:
    """The commands to start a service that a command tells of."""
    done = failstop(word, "--name", name)
    return re.findall(r"`(failstop run[^`]*)`", " ".join((done.stdout + done.stderr).split()))


def test_the_command_that_is_told_starts_the_same_service(started: Started, tmp_path: Path) -> None:
    started.kill()
    for word in ("why", "status", "reset"):
        assert next(iter(told(started.name, word)), "") == started.expected, word
    started.type(started.expected, tmp_path)
    with Robot(started.name) as robot:
        assert robot.settings["limits.vx_mps"] == 0.11
        with pytest.raises(Exception, match="seat"):
            robot.enable()


def test_after_an_end_in_order_it_is_told_too(started: Started, tmp_path: Path) -> None:
    robot = Robot(started.name)
    started.process.send_signal(signal.SIGTERM)
    started.process.wait(10.0)
    with pytest.raises(NoService, match=re.escape(f"start it with `{started.expected}`")):
        _ = robot.state
    assert told(started.name, "why") == [started.expected]
    started.type(started.expected, tmp_path)
    _ = robot.state


def test_a_state_of_the_dying_service_tells_it(started: Started) -> None:
    robot = Robot(started.name)
    _ = robot.state
    started.process.kill()
    started.process.wait()
    try:
        do = str(robot.why())
    except NoService as gone:  # the rest of it has ended already
        do = str(gone)
    assert started.expected in do
    started.kill()
    started.type(started.expected, Path("/"))


def test_the_stop_tool_writes_to_the_port_of_the_service_that_has_died(started: Started, tmp_path: Path) -> None:
    started.kill()
    port = started.board.link
    started.board.events()
    done = failstop("stop", "--name", started.name)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"directly to {port}, the port of the last run (no service '{started.name}' runs)" in done.stdout
    wait_for("the stop", lambda: any(event.is_stop for event in started.board.events()))
    started.type(started.expected, tmp_path)


@pytest.mark.parametrize(
    ("groups", "is_it"),
    [
        ("0::/system.slice/failstop.service\n", True),
        ("12:cpu:/\n1:name=systemd:/system.slice/failstop.service\n", True),
        ("0::/user.slice/user-1000.slice/user@1000.service/app.slice/gnome-terminal.service\n", False),
        ("0::/system.slice/system-failstop.slice/failstop@left.service\n", False),
        ("0::/\n", False),
        ("", False),
    ],
)
def test_by_its_unit_is_known_from_the_control_group(groups: str, is_it: bool, tmp_path: Path) -> None:
    (tmp_path / "cgroup").write_text(groups)
    assert instances.by_its_unit(instance.DEFAULT_NAME, str(tmp_path / "cgroup")) is is_it
    assert not instances.by_its_unit(instance.DEFAULT_NAME, str(tmp_path / "absent"))


def test_a_unit_of_a_name_is_known_too(tmp_path: Path) -> None:
    (tmp_path / "cgroup").write_text("0::/system.slice/system-failstop.slice/failstop@left.service\n")
    assert instances.by_its_unit("left", str(tmp_path / "cgroup"))
    assert not instances.by_its_unit("right", str(tmp_path / "cgroup"))

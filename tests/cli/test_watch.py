"""`failstop status -w` in a real terminal."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator

import pytest

from failstop.messages import layout
from failstop_lab.trial import Trial, wait_for
from tests.support.commands import FAILSTOP
from tests.support.typist import Typist

CPU_S = 4.0
MOST = 1.0
"""Its processor time as a share of telemetry's, on the same machine at the same time; measured: 0.5."""


IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
COLUMNS = 250
"""Enough for the whole command that starts a trial's service."""


@pytest.fixture
def watch(trial: Trial) -> Iterator[Typist]:
    with Typist.failstop("status", "-w", "--name", trial.name) as typist:
        typist.wait("STOPPED  blocked: disabled")
        typist.wait("telemetry")
        yield typist


def test_it_follows_what_happens(watch: Typist, trial: Trial) -> None:
    trial.enable()
    watch.wait("blocked: no command")
    trial.drive(0.8, each=watch.peek)
    assert "█" in watch.screen()
    trial.robot.estop("hand near")
    watch.wait("stop latched: stop request: hand near")
    watch.wait(f"`failstop reset --name {trial.name}`")


def test_only_changed_lines_are_written(watch: Typist, trial: Trial) -> None:
    watch.look(0.3)
    before = len(watch.raw)
    until_s = time.monotonic() + 2.0
    while time.monotonic() < until_s:
        watch.look(0.1)
    written = watch.raw[before:]
    assert written, "it is alive"
    assert "failstop enable" not in written
    assert "\x1b[2J" not in written
    assert len(written) / 2.0 < 6000, "bytes a second, for a slow connection"


@pytest.mark.parametrize(("how", "code"), [(b"Q", 0), (b"\x03", 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_the_terminal_is_given_back(watch: Typist, how: bytes | signal.Signals, code: int) -> None:
    watch.type(how) if isinstance(how, bytes) else watch.process.send_signal(how)
    assert watch.end() == code
    assert watch.restored()


def test_another_size(watch: Typist) -> None:
    watch.resize(50, 12)
    watch.wait("more lines: the window is too small")
    lines = watch.look(0.3).split("\n")
    assert len(lines) <= 12
    assert max(map(len, lines)) <= 50
    watch.resize(120, 40)
    watch.wait("telemetry")


def test_without_a_service_or_a_terminal(trial: Trial) -> None:
    with Typist.failstop("status", "-w", "--name", "nobody-here") as watch:
        assert watch.end() == 3
        assert "\x1b[?1049h" not in watch.raw
    command = [*FAILSTOP, "status", "-w", "--name", trial.name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, stdin=subprocess.DEVNULL)
    assert done.returncode == 1
    assert "run it in a terminal" in done.stderr


def _ticks(pid: int) -> int:
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:
        fields = file.read().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


@pytest.mark.slow
def test_it_costs_little(watch: Typist, trial: Trial) -> None:
    trial.enable()
    wait_for("the screen to settle", lambda: "no command" in watch.look(0.05))
    pids = (watch.process.pid, trial.service.pids()[layout.TELEMETRY])
    before = [_ticks(pid) for pid in pids]
    trial.drive(CPU_S, each=watch.peek)
    spent, telemetry = (_ticks(pid) - ticks for pid, ticks in zip(pids, before, strict=True))
    assert spent < telemetry * MOST


def test_the_end_of_the_service_and_its_return(watch: Typist, trial: Trial) -> None:
    watch.wait("port_owner")
    pid = trial.service.pids()[layout.SUPERVISOR]
    trial.leave()
    trial.service.end()
    watch.wait("NO SERVICE")
    watch.wait("waiting for it to come back")
    assert "blocked" not in watch.screen()
    trial.service.start()
    watch.wait("STOPPED  blocked: disabled")
    assert trial.service.pids()[layout.SUPERVISOR] != pid
    watch.wait(str(trial.service.pids()[layout.PORT_OWNER]))
    trial.service.kill()
    watch.wait("NO SERVICE")
    watch.resize(COLUMNS, 24)
    watch.wait("`failstop run --name")
    assert f"`failstop stop --name {trial.name}`" in watch.screen()

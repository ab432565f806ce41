"""`failstop stop` by either name, with and without a service: a stop is out in the end, and it says by which way."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import pty
import signal
import subprocess
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.api import client
from failstop.board.burst import BURST
from failstop.lab.trial import Trial, judge, wait_for
from failstop.messages import layout, segments
from failstop.shm import cell
from failstop.shm.segment import HEADER_BYTES
from tests.support.commands import FAILSTOP, failstop
from tests.support.shared_trial import IMU_HZ, goes_on, set_off

needs_root = pytest.mark.skipif(os.getuid() != 0, reason="needs root, whom an exclusive port does not keep out")
PR_CAPBSET_DROP = 24
CAP_SYS_ADMIN = 21


@pytest.fixture
def port(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A second board's port: its link, and the board's side of it."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    link = tmp_path / "other"
    link.symlink_to(os.ttyname(slave))
    yield str(link), master
    os.close(master)
    os.close(slave)


def written(master: int) -> bytes:
    try:
        return os.read(master, 4096)
    except BlockingIOError:
        return b""


@contextlib.contextmanager
def another_layout(name: str) -> Iterator[None]:
    """The service's memory as one of another version has it."""
    before: list[tuple[int, bytes]] = []
    run, _ = client.run(name)
    try:
        for process in layout.PROCESS_NAMES:
            memory = os.open(segments.path_of(run, process), os.O_RDWR)
            raw = os.pread(memory, HEADER_BYTES, 0)
            before.append((memory, raw))
            entry = cell.check(raw, cell.seed("header", 0))
            assert entry is not None
            other = bytearray(entry[2])
            other[8] ^= 0xFF
            os.pwrite(memory, cell.build(1, 0, bytes(other), cell.seed("header", 0), 200), 0)
        yield
    finally:
        for memory, raw in before:
            os.pwrite(memory, raw, 0)
            os.close(memory)


@contextlib.contextmanager
def frozen(trial: Trial) -> Iterator[None]:
    """Nobody in the service does anything."""
    pids = trial.service.pids().values()
    try:
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        yield
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)


def test_by_the_service_that_runs(trial: Trial) -> None:
    """The other name of the command: `stop` is that of the tests below."""
    set_off(trial)
    asked_ns = time.monotonic_ns()
    result = failstop("estop", "hand", "near", "wheel", "--name", trial.name)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("stop latched (stop request: hand near wheel (failstop estop, pid ")
    assert f"by the service '{trial.name}'; next: `failstop reset --name {trial.name}`" in result.stdout
    trial.drive(0.2)
    stopped = judge(trial.board.events(), asked_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.motion_after == 0


def test_a_latched_stop_is_asked_for_again(trial: Trial) -> None:
    assert failstop("stop", "one", "--name", trial.name).returncode == 0
    trial.board.events()
    again = failstop("stop", "two", "--name", trial.name)
    assert "stop latched (stop request: one (failstop stop" in again.stdout, "the first cause is the one to look for"
    assert again.returncode == 0
    assert any(event.is_stop for event in trial.board.events())


def test_the_port_s_own_service_is_asked_whatever_it_is_called(trial: Trial) -> None:
    result = failstop("stop", "--device", trial.link)
    assert (result.returncode, result.stderr) == (0, "")
    assert f"by the service '{trial.name}'" in result.stdout
    assert sum(event.is_stop for event in trial.board.events()) >= 4
    assert (trial.robot.state.estop or "").startswith("stop request (failstop stop, pid ")


@pytest.mark.parametrize("how", ["option", "file"])
def test_a_service_at_another_port_swallows_nothing(
    trial: Trial, port: tuple[str, int], how: str, tmp_path: Path
) -> None:
    link, master = port
    (tmp_path / "other.toml").write_text(f'device.path = "{link}"\n')
    words = ["--device", link] if how == "option" else ["--config", str(tmp_path / "other.toml")]
    result = failstop("stop", "--name", trial.name, *words)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == f"stop frame sent (after 0.0 s), directly to {link}\n"
    assert written(master) == BURST
    assert trial.robot.state.estop is None


def test_on_the_port_itself_without_a_service(name: str, port: tuple[str, int]) -> None:
    link, master = port
    result = failstop("stop", "hand", "near", "wheel", "--name", name, "--device", link)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == f"stop frame sent (after 0.0 s), directly to {link}\n"
    assert written(master) == BURST


@needs_root
def test_beside_a_service_that_does_not_obey(fresh: Trial) -> None:
    fresh.board.events()
    with frozen(fresh):
        result = failstop("stop", "--name", fresh.name)
        assert result.returncode == 0
        assert result.stdout.endswith(f"directly to {fresh.link}\n")
        assert "has not latched it within 1 s: writing to the port itself" in result.stderr
        fresh.board.wait_for(lambda event: event.is_stop, 10.0)


def test_a_service_of_another_layout_is_stopped_by_its_pipe(trial: Trial) -> None:
    set_off(trial)
    with another_layout(trial.name):
        result = failstop("estop", "even so", "--name", trial.name)
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
    assert result.returncode == 0
    assert result.stdout.startswith(f"the service '{trial.name}' has written the stop; whether it is latched can't be")
    assert "with another layout" in result.stderr
    assert (trial.robot.state.estop or "").startswith("stop request: even so (failstop estop")


def test_a_port_that_is_gone_is_told_with_the_latch(trial: Trial) -> None:
    trial.board.unplug()
    wait_for("the loss", lambda: trial.robot.state.device.state != "open")
    result = failstop("stop", "--name", trial.name)
    assert result.returncode == 0
    assert "stop latched (" in result.stdout
    assert "so no stop reaches the board: use the POWER SWITCH" in result.stderr
    trial.board.replug()


def no_admin() -> None:
    """Give up, in the child, root's way past an exclusive port, and keep the sight of others' descriptors."""
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_ADMIN, 0, 0, 0)


@needs_root
def test_whoever_holds_the_port_is_named(port: tuple[str, int]) -> None:
    link, master = port
    with open(link, "rb", buffering=0) as held:
        holder = subprocess.Popen(["sleep", "60"], stdin=held)
        fcntl.ioctl(held, termios.TIOCEXCL)
    try:
        command = [*FAILSTOP, "stop", "--device", link, "--wait", "0"]
        done = subprocess.run(command, preexec_fn=no_admin, capture_output=True, text=True, timeout=20, check=False)
        assert (done.returncode, done.stdout) == (1, "")
        assert f"{link} is held exclusively by " in done.stderr
        assert f"sleep (pid {holder.pid})" in done.stderr
        assert "use the POWER SWITCH" in done.stderr
        assert written(master) == b""
    finally:
        holder.kill()
        holder.wait()


def test_of_two_services_one_is_stopped_or_all_that_run_are_asked(trial: Trial, name: str) -> None:
    """No port is written to, nor waited for."""
    with Trial(name, imu_hz=IMU_HZ) as other:
        trial.enable()
        other.enable()
        trial.robot.estop("only this one")
        wait_for("the latch", lambda: trial.robot.state.estop is not None)
        goes_on(other)
        assert other.robot.state.estop is None
        wait_for("a reset to be taken", trial.reset)
        done = failstop("stop", "--services", "the", "machine", "sleeps")
        assert done.returncode == 0
        for each in (trial, other):
            assert f"{each.name!r}" in done.stdout
            assert str(each.robot.state.estop).startswith("stop request: the machine sleeps")

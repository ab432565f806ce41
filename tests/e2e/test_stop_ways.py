"""`failstop stop` by either name, with and without a service: a stop is out in the end, and it says by which way."""

from __future__ import annotations

import ctypes
import fcntl
import os
import subprocess
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import config
from failstop.api.client import send_stop
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.files import root
from failstop_lab.trial import Trial, judge, wait_for
from tests.support.children import NOBODY, call
from tests.support.commands import FAILSTOP, failstop
from tests.support.ptys import bare_port
from tests.support.shared_trial import IMU_HZ, goes_on, set_off
from tests.support.simulated import Simulated

needs_root = pytest.mark.skipif(os.getuid() != 0, reason="needs root, whom an exclusive port does not keep out")
PR_CAPBSET_DROP = 24
CAP_SYS_ADMIN = 21


@pytest.fixture
def port(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A second board's port: its link, and the board's side of it."""
    link = tmp_path / "other"
    with bare_port(link) as master:
        os.set_blocking(master, False)
        yield str(link), master


def written(master: int) -> bytes:
    try:
        return os.read(master, 4096)
    except BlockingIOError:
        return b""


def test_the_port_s_own_service_is_asked_whatever_it_is_called(trial: Trial) -> None:
    result = failstop("stop", "--device", trial.link)
    assert (result.returncode, result.stderr) == (0, "")
    assert f"by the service '{trial.name}'" in result.stdout
    assert sum(event.is_stop for event in trial.board.events()) >= 4
    assert (trial.robot.state.estop or "").startswith("stop request (says it is failstop stop, pid ")


@pytest.mark.parametrize("how", ["option", "file"])
def test_a_service_at_another_port_swallows_nothing(
    trial: Trial, port: tuple[str, int], how: str, tmp_path: Path
) -> None:
    """Only --device says that another robot is meant. By a file, the service may be the one that is meant, with its
    board at another port than the file says."""
    link, master = port
    (tmp_path / "other.toml").write_text(f'device.path = "{link}"\n')
    words = ["--device", link] if how == "option" else ["--config", str(tmp_path / "other.toml")]
    result = failstop("stop", "--name", trial.name, *words)
    asked, _, sent = result.stdout.rpartition("stop frame")
    assert sent == f" for {BOARD.name} sent (after 0.0 s), directly to {link}; no settings name another board\n"
    assert (result.returncode, f"nothing at {link} answers" in result.stderr) == (1, True)
    assert written(master).startswith(BURST)
    assert f"by the service '{trial.name}'" in asked if how == "file" else not asked
    assert (trial.robot.state.estop is None) == (how == "option")


def test_a_service_whose_board_left_the_port_in_its_file_is_stopped_by_that_file(
    name: str, port: tuple[str, int], tmp_path: Path
) -> None:
    """The port in the file may be another device's by now, so nothing is written there."""
    link, master = port
    file = tmp_path / "its.toml"
    file.write_text(f'device.path = "{link}"\n')
    with Trial(name, ("--config", str(file)), imu_hz=IMU_HZ) as trial:
        result = failstop("stop", "--name", name, "--config", str(file))
        assert (result.returncode, result.stderr) == (0, "")
        assert f"by the service '{name}'" in result.stdout
        assert f"its board is at {trial.link}, not at {link} as the file given with --config says" in result.stdout
        assert (trial.robot.state.estop or "").startswith("stop request")
    assert written(master) == b""


def test_where_the_port_is_absent_the_service_that_runs_is_named(trial: Trial, tmp_path: Path) -> None:
    """At once, and not only when the wait is over: its robot may be the one that drives."""
    way = f"`failstop stop --name {trial.name}`"
    words = ["stop", "--name", f"{trial.name}-2", "--wait", "0"]
    settings = Path(config.installed(f"{trial.name}-2"))
    settings.parent.mkdir(parents=True, exist_ok=True)
    settings.write_text(f'device.path = "{tmp_path / "gone"}"\n')
    try:
        first, last = failstop(*words).stderr.splitlines()
        named = failstop(*words, "--device", str(tmp_path / "gone")).stderr
    finally:
        settings.unlink()
    assert first.startswith("failstop: a service with another port is running; to stop its robot: `failstop stop ")
    assert last.startswith(f"failstop: no device {tmp_path / 'gone'}")
    assert way in first
    assert way in last
    assert trial.name not in named, "the user knows which robot"
    assert trial.robot.state.estop is None


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


def test_a_program_that_shares_the_port_is_named_because_it_may_drive_on(port: tuple[str, int]) -> None:
    """Most drivers don't open the port exclusively, so the stop can be written, and their next frame ends it."""
    link, master = port
    with open(link, "r+b", buffering=0) as shared:
        driver = subprocess.Popen(["sleep", "60"], stdin=shared)
    try:
        done = failstop("stop", "--device", link, "--wait", "0")
        assert done.returncode == 1
        assert "stop frame" in done.stdout
        assert written(master) != b""
        assert f"sleep (pid {driver.pid}" in done.stderr
        assert f"also has {link} open and may drive on: use the POWER SWITCH" in done.stderr
    finally:
        driver.kill()
        driver.wait()
    assert f"(pid {driver.pid}" not in failstop("stop", "--device", link, "--wait", "0").stderr


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


@needs_root
def test_whoever_was_written_past_is_named_with_the_command_that_asks_it(trial: Trial, tmp_path: Path) -> None:
    hidden = {**os.environ, root.VARIABLE: str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
    command = [*FAILSTOP, "stop", "--device", trial.link]
    done = subprocess.run(command, env=hidden, capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 1
    assert f"the service '{trial.name}' was not asked, still has {trial.link}" in done.stderr
    assert f"`failstop stop --name {trial.name}` as the user who started it" in done.stderr


@pytest.mark.claim("ASK-1")
def test_by_an_unprivileged_user(trial: Trial) -> None:
    set_off(trial)
    asked_ns = time.monotonic_ns()
    call(lambda: send_stop(trial.name, "nobody says so"), NOBODY if os.getuid() == 0 else -1)
    trial.drive(0.2)
    stopped = judge(trial.board.events(), asked_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.motion_after == 0
    assert trial.robot.state.estop == "stop request: nobody says so"


# On the simulated machine.


def test_a_latched_stop_is_asked_for_again(simulated: Simulated) -> None:
    by = "by the service 'failstop'; next: `failstop reset`"
    for word, said in (("estop", "one"), ("stop", "two")):
        simulated.board.events()
        told = simulated.printed(word, said)
        assert told.startswith("stop latched (stop request: one"), "the first cause"
        assert by in told
        assert any(event.is_stop for event in simulated.board.events())


def test_a_service_that_does_not_obey_is_stopped_beside(simulated: Simulated) -> None:
    simulated.set_off()
    for name in simulated.pids():
        simulated.suspend(name)
    code, out, err = simulated.command("stop")
    port = simulated.link
    unknown = f"nobody knows whether the board at {port} answers, because a service reads that port"
    assert (code, out) == (0, f"stop frame sent (after 0.0 s), directly to {port}\n{unknown}\n")
    assert "has not latched it within 1 s; writing the stop to the port instead" in err
    assert not simulated.turning()


def test_without_a_service_of_that_name_the_service_at_the_port_is_asked(simulated: Simulated) -> None:
    """Root would otherwise write past it, and it would drive on."""
    simulated.set_off()
    simulated.lab.write(f"{config.FOLDER}/left.toml", f'device.path = "{simulated.link}"\n')
    code, out, err = simulated.command("stop", "--name", "left")
    assert (code, err) == (0, "")
    assert "by the service 'failstop'" in out
    simulated.drive(0.3)
    assert not simulated.turning()


def test_a_service_that_root_can_t_see_is_named_because_it_may_drive_on(simulated: Simulated) -> None:
    """As after `failstop run` by another user."""
    simulated.set_off()
    hidden = {root.VARIABLE: "/elsewhere", "XDG_RUNTIME_DIR": "/nowhere"}
    code, out, err = simulated.lab.command(("stop", "--device", simulated.link), environ=hidden)
    assert (code, "directly to" in out) == (1, True)
    assert f"was not asked, still has {simulated.link} and may drive on: use the POWER SWITCH" in err
    simulated.drive(0.3)
    assert simulated.turning(), "it has not heard of the stop"


def test_a_port_that_is_gone_is_told_with_the_latch(simulated: Simulated) -> None:
    simulated.board.unplug()
    simulated.wait_for("the loss", lambda: simulated.robot.state.device.state != "open")
    code, out, err = simulated.command("stop")
    assert (code, "stop latched (" in out) == (1, True)
    assert "so no stop reaches the board: use the POWER SWITCH" in err

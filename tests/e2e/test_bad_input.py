"""Bad input: a clear message that names the thing and the remedy, the right exit code, and nothing moved by it."""

from __future__ import annotations

import grp
import os
import pty
import pwd
import shutil
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from failstop import FailstopError
from failstop.api.client import run
from failstop.cli.main import main
from failstop.files import instance
from failstop.lab.trial import Trial, wait_for
from failstop.messages import layout, segments
from failstop.procs import rights
from failstop.shm.segment import HEADER_BYTES
from failstop.supervisor.blackbox import MOST_SAVERS
from tests.support.children import NOBODY, call
from tests.support.commands import FAILSTOP, failstop
from tests.support.shared_trial import IMU_HZ, goes_on, set_off
from tests.support.simulated import Simulated


def _one_line(result: subprocess.CompletedProcess[str]) -> str:
    """The error, which must be one line."""
    assert result.stderr.count("\n") == 1, result.stderr
    return result.stderr.strip()


def test_no_device(name: str) -> None:
    result = failstop("run", "--name", name, "--device", "/dev/ttyNONE")
    assert result.returncode == 1
    assert _one_line(result).startswith("failstop: no device /dev/ttyNONE: plug the board in")
    assert failstop("status", "--name", name).returncode == 3


def limited(files: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command that may open only so many files."""
    command = ["/bin/sh", "-c", f'ulimit -n {files}; exec "$@"', "sh", *FAILSTOP, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


LACKING = f"failstop: RLIMIT_NOFILE is {{}}, and {rights.DESCRIPTORS} open files are needed: raise it"


def test_a_limit_that_may_be_raised_is_raised(name: str) -> None:
    raised = "import resource; from failstop.procs import rights; rights.take_descriptors();"
    found = subprocess.run(
        [
            "/bin/sh",
            "-c",
            'ulimit -S -n 40; exec "$@"',
            "sh",
            sys.executable,
            "-c",
            raised + "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert found.stdout == f"{rights.DESCRIPTORS}\n"


def test_the_service_needs_no_more_descriptors_than_it_asks_for(fresh: Trial) -> None:
    for number in range(MOST_SAVERS):
        fresh.robot.estop(f"number {number}")
        wait_for("the latch", lambda: fresh.robot.state.estop is not None)
        wait_for("a reset", lambda: _reset(fresh))
    wait_for(
        "the savers", lambda: len(psutil.Process(fresh.service.pids()["supervisor"]).children()) == 4 + MOST_SAVERS
    )
    most = len(os.listdir(f"/proc/{fresh.service.pids()['supervisor']}/fd"))
    assert most + len(layout.PROCESS_NAMES) <= rights.DESCRIPTORS, "with those of a dead run's segments"


def _reset(trial: Trial) -> bool:
    try:
        trial.robot.reset()
    except FailstopError:
        return False
    return True


@pytest.mark.parametrize(("files", "word"), [(8, "status"), (11, "enable")])
def test_too_few_descriptors_for_a_command_are_one_line(trial: Trial, files: int, word: str) -> None:
    result = limited(files, word, "--name", trial.name)
    assert result.returncode == 1
    assert _one_line(result).startswith(LACKING.format(files))


def test_too_few_descriptors_for_a_command_are_enough_for_a_stop(trial: Trial) -> None:
    result = limited(8, "estop", "few", "--name", trial.name)
    assert result.returncode == 0
    assert "Traceback" not in result.stderr
    assert str(trial.robot.state.estop).startswith("stop request: few")


def test_too_few_descriptors_for_a_service_of_its_own_are_one_line() -> None:
    result = limited(40, "demo")
    assert result.returncode == 1
    assert "the service ended: " + LACKING.format(40) in _one_line(result)


def test_not_a_tty(name: str, tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_bytes(b"untouched")
    result = failstop("run", "--name", name, "--device", str(plain))
    assert result.returncode == 1
    assert "is a regular file, not a serial port" in _one_line(result)
    assert plain.read_bytes() == b"untouched"


@pytest.mark.skipif(os.getuid() != 0, reason="needs root to become another user")
def test_no_permission(name: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    # Whatever a refused run imports late: the interpreter's library may be out of nobody's reach.
    assert grp
    assert pwd
    assert main(["run", "--name", name, "--device", "/dev/ttyNONE"]) == 1
    capfd.readouterr()
    master, slave = pty.openpty()
    device = os.ttyname(slave)
    os.chmod(device, 0o600)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    assert call(lambda: main(["run", "--name", name, "--device", device]), NOBODY) == 1
    said = capfd.readouterr().err
    shutil.rmtree(f"/dev/shm/failstop-{NOBODY}", ignore_errors=True)
    os.close(master)
    os.close(slave)
    assert "permission" in said
    assert device in said


def test_name_already_running(trial: Trial) -> None:
    """A refused second run does not stop the first."""
    set_off(trial)
    result = failstop("run", "--name", trial.name, "--device", trial.link)
    assert result.returncode == 1
    pid = trial.service.pids()["supervisor"]
    assert _one_line(result) == (
        f"failstop: '{trial.name}' is already running (pid {pid}): stop it first, or choose another --name"
    )
    goes_on(trial)


def test_memory_of_a_dead_run_is_in_no_way_and_nothing_is_left_of_this_one(name: str) -> None:
    incarnation = 4711
    for spec in layout.SEGMENTS:
        segments.create(segments.memory(name, incarnation), spec.name, incarnation).close()
    with Trial(name, imu_hz=IMU_HZ) as trial:
        assert trial.robot.state.enabled is False
        assert run(name)[0] != segments.memory(name, incarnation)
        set_off(trial)
        trial.leave()
        runtime = Path(instance.find(name))
        assert trial.service.end() == 0
        assert not [found for found in os.listdir("/dev/shm") if name in found]
        assert {found.name for found in runtime.iterdir()} == {"lock", "last"}


def test_name_already_running_in_another_runtime_directory(fresh: Trial) -> None:
    Path(instance.lock_path(instance.find(fresh.name))).unlink()
    result = failstop("run", "--name", fresh.name, "--device", fresh.link)
    assert result.returncode == 1
    assert "is already running (pid" in _one_line(result)
    set_off(fresh)


def test_damaged_client_slot_is_passed_over(simulated: Simulated) -> None:
    memory, _ = simulated.load("failstop.api.client").run(simulated.name)
    fd = simulated.os.open(segments.path_of(memory, "client.0"), os.O_RDWR)
    simulated.os.pwrite(fd, bytes(HEADER_BYTES), 0)
    simulated.enable()
    simulated.drive(0.2)
    assert simulated.turning()
    assert simulated.robot.state.clients[0].slot == 1


def test_full_client_table(simulated: Simulated) -> None:
    made = simulated.load("failstop.api.client").Client
    clients = [made(simulated.name, f"filler {number}") for number in range(layout.CLIENT_SLOTS)]
    code, _, err = simulated.command("enable")
    assert (code, err.count("\n")) == (1, 1)
    assert "client slots" in err
    assert "close a client" in err
    assert simulated.command("estop", "even", "so")[0::2] == (0, "")
    for client in clients:
        client.close()
    assert simulated.command("reset")[0] == 0


def test_no_service(simulated: Simulated) -> None:
    simulated.leave()
    simulated.end()
    for words in ("status", "enable", "disable", "reset", "drive 0 0 0"):
        code, _, err = simulated.command(*words.split())
        assert (code, err.count("\n")) == (3, 1), words
        assert "start it with `failstop run" in err
    with pytest.raises(simulated.failstop.NoService):
        simulated.failstop.Robot()


@pytest.mark.skipif(os.getuid() != 0, reason="needs root to become another user")
def test_user_outside_the_group_may_stop_but_not_drive(trial: Trial) -> None:
    code = """
import os, sys
from failstop import FailstopError, Robot
os.setgroups([]); os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)
robot = Robot(sys.argv[1])
assert robot.state.blocked == "disabled"
try:
    robot.enable()
except FailstopError as error:
    print(error)
robot.estop("by nobody")
"""
    result = subprocess.run(
        [sys.executable, "-c", code, trial.name], capture_output=True, text=True, timeout=20, check=True
    )
    assert "may stop" in result.stdout
    assert "join the group `failstop`" in result.stdout
    until = time.monotonic() + 2
    while not trial.robot.state.estop and time.monotonic() < until:
        time.sleep(0.005)
    assert "by nobody" in (trial.robot.state.estop or "")

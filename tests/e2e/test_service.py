"""The service as a whole: start, end, a lost port, what outlives what."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import struct

import psutil
import pytest

from failstop.board.rrc.burst import BURST
from failstop.messages import layout
from failstop_lab.trial import Trial, wait_for
from tests.support.commands import failstop
from tests.support.simulated import Simulated

TIOCGEXCL = 0x80045440


# With real processes.


@pytest.mark.claim("START-1")
def test_first_bytes_are_the_burst_and_no_process_outlives_a_killed_supervisor(fresh: Trial) -> None:
    motor = [event for event in fresh.board.events() if event.is_motor]
    assert motor[0].is_stop
    assert BURST.count(bytes.fromhex("AA550316")) == 4
    assert not any(event.is_motion for event in motor)
    pids = fresh.service.pids()
    fresh.leave()
    fresh.service.kill()
    wait_for("every process to be gone", lambda: not any(_alive(pid) for pid in pids.values()))


def _alive(pid: int) -> bool:
    """A zombie is dead: when it is collected is its new parent's affair."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_processes_have_names_and_no_more_threads_and_ports_than_they_need(trial: Trial) -> None:
    # The supervisor has its opener besides. Telemetry, which no stop needs, writes its files from a thread of its own.
    watched = {"supervisor": 4 + 1, "port_owner": 4, "stopper": 2, "gate": 0}
    ports = {"supervisor": 1, "port_owner": 1, "stopper": 1, "gate": 0, "telemetry": 1}
    for name, pid in trial.service.pids().items():
        process = psutil.Process(pid)
        if name in watched:
            wait_for(f"the watchers of {name}", lambda p=process, n=name: p.num_threads() == 1 + watched[n])  # type: ignore[misc]
        assert process.name() == f"fs:{name}"
        assert name in process.cmdline()
        files = [os.readlink(f"/proc/{pid}/fd/{fd}") for fd in os.listdir(f"/proc/{pid}/fd")]
        assert sum(file.startswith("/dev/pts/") for file in files) == ports[name], name


@pytest.mark.claim("MOVE-1")
def test_one_process_opens_the_port_exclusively(trial: Trial) -> None:
    fd = os.open(trial.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        answer = fcntl.ioctl(fd, TIOCGEXCL, struct.pack("i", 0))
    finally:
        os.close(fd)
    assert struct.unpack("i", answer) == (1,)


@pytest.mark.parametrize("source", ["telop", "gamepad"])
def test_teleop_names_a_source_that_is_no_client_s_before_it_takes_the_screen(trial: Trial, source: str) -> None:
    done = failstop("teleop", "--source", source, "--name", trial.name)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert f"source '{source}'" in done.stderr
    assert trial.robot.state.clients == ()


# On the simulated machine.


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_end_says_that_the_board_has_acknowledged_its_stop(simulated: Simulated, number: int) -> None:
    simulated.set_off()
    ended_ns = simulated.now_ns()
    assert simulated.end(number) == 0
    assert simulated.stops(ended_ns, 25) >= 8
    assert simulated.living() == []
    assert re.search(r"written twice, acknowledged by the board after \d+\.\d ms\n", simulated.said)


@pytest.mark.parametrize("told", [True, False], ids=["known to be deaf", "deaf just now"])
def test_a_board_that_does_not_hear_the_last_stop_is_an_error(simulated: Simulated, told: bool) -> None:
    simulated.set_off()
    simulated.board.deaf(True)
    if told:
        simulated.wait_for("the loss", lambda: simulated.robot.state.device.link == "deaf")
    assert simulated.end() == 1
    assert simulated.turning(), "it could not be stopped"
    link = "deaf" if told else "alive"
    assert (
        f"written twice, NOT acknowledged by the board (link {link}); if the wheels turn, use the POWER"
        in simulated.said
    )


def test_a_last_stop_that_nothing_takes_is_an_error(simulated: Simulated) -> None:
    simulated.board.unplug()
    simulated.wait_for("the loss", lambda: simulated.robot.state.device.state != "open")
    simulated.leave()
    assert simulated.end() == 1
    assert "the second stop could NOT be written" in simulated.said


def test_a_long_absence_of_a_standing_robot_is_no_motion() -> None:
    """The IMU needs a while after the return before it says anything, and its silence is no shaking."""
    simulated = Simulated(imu_hz=110.0)
    robot = simulated.robot
    telemetry = simulated.load("failstop.api.client").attach(simulated.name, layout.TELEMETRY)
    simulated.wait_for("the IMU's word", lambda: telemetry.word("still_ns").get())
    simulated.enable()
    simulated.board.unplug()
    robot.wait_for("latched", 1.0)
    assert robot.state.estop == "device lost"
    simulated.wait(1.8)  # longer than wheels may take to stand
    simulated.board.replug()
    simulated.wait_for("the IMU's word", lambda: (stop := robot.state.last_stop) and stop.observed_s == 0)
    stop = robot.state.last_stop
    assert stop.reason == "device lost"
    assert stop.written_s == pytest.approx(1.8, abs=0.1), "the burst at the return is its stop"
    simulated.wait_for("the board's answer", lambda: robot.state.last_stop.acknowledged_s)
    assert "CRITICAL" not in simulated.said

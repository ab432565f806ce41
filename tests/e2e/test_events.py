"""What the service tells people of itself, as programs read it: kinds and fields, from a real service and board."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from failstop import Robot
from failstop.api.errors import NoService, Refused
from failstop.api.events import Event, EventLog
from failstop.lab.trial import Trial, wait_for
from failstop.supervisor.kinds import BY_NAME
from tests.support.commands import failstop


class Listener:
    """All events of a service, those included that came before it."""

    def __init__(self, trial: Trial) -> None:
        self.log = EventLog(trial.name)
        self.heard: list[Event] = []

    def of(self, kind: str, **fields: object) -> list[Event]:
        """The events of a kind with these fields, so far."""
        self.heard += self.log.read()
        return [e for e in self.heard if e.kind == kind and fields.items() <= e.fields.items()]

    def wait(self, kind: str, **fields: object) -> Event:
        """The first such event, waited for."""
        wait_for(f"{kind} {fields}", lambda: bool(self.of(kind, **fields)))
        return self.of(kind, **fields)[0]


@pytest.fixture
def listener(trial: Trial) -> Iterator[Listener]:
    made = Listener(trial)
    yield made
    for event in made.heard:
        kind = BY_NAME[event.kind]
        assert set(kind.fields) <= event.fields.keys(), event
    assert [event.seq for event in made.heard] == list(range(1, len(made.heard) + 1))
    assert [event.ns for event in made.heard] == sorted(event.ns for event in made.heard)


def test_from_the_start_to_a_stop_and_back(trial: Trial, listener: Listener) -> None:
    assert listener.wait("ready").level == "notice"
    listener.wait("link", state="alive")
    pid = os.getpid()
    trial.robot.estop("too early")
    listener.wait("stop")
    with pytest.raises(Refused):
        trial.robot.enable()
    listener.wait("refused", who="trial", pid=pid, verb="enable")
    trial.enable()
    listener.wait("reset", who="trial", pid=pid)
    assert listener.wait("enabled", who="trial", pid=pid).text == f"motion enabled by trial (pid {pid})"
    trial.robot.enable()
    trial.robot.disable()
    listener.wait("disabled", who="trial")
    trial.robot.disable()
    trial.robot.enable()
    trial.robot.estop("hand near wheel")
    wait_for("the second stop", lambda: len(listener.of("stop")) == 2)
    stop = listener.of("stop")[1]
    assert str(stop.fields["reason"]).startswith("stop request: hand near wheel (trial")
    assert stop.fields["noticed_by"] == "port_owner"
    assert stop.fields["written_by"] == "port owner"
    assert 0 < float(stop.fields["latency_us"]) < 50_000
    assert stop.fields["epoch"] == trial.robot.state.epoch
    wait_for("its outcome", lambda: listener.of("stop_outcome", epoch=stop.fields["epoch"]) != [])
    outcome = listener.of("stop_outcome", epoch=stop.fields["epoch"])[0]
    assert float(outcome.fields["acknowledged_us"]) > 0
    assert outcome.fields["link"] == "alive"
    assert (len(listener.of("enabled")), len(listener.of("disabled"))) == (2, 1), "what changes nothing is not told"


def test_deaths_and_hangs(trial: Trial, listener: Listener) -> None:
    pid = trial.service.pids()["telemetry"]
    os.kill(pid, signal.SIGKILL)
    listener.wait("died", process="telemetry", pid=pid, how="was killed by SIGKILL")
    listener.wait("restarting", process="telemetry")
    wait_for("telemetry", trial.service.ready)
    hung = trial.service.pids()["stopper"]
    os.kill(hung, signal.SIGSTOP)
    fenced = listener.wait("fenced", process="stopper", pid=hung)
    assert float(fenced.fields["silent_ms"]) >= 250
    assert 0 <= float(fenced.fields["kill_us"]) <= float(fenced.fields["gone_us"])


def test_a_port_that_goes_and_comes_back(trial: Trial, listener: Listener) -> None:
    trial.board.unplug()
    assert listener.wait("device_lost").fields["path"] == trial.link
    assert len(listener.of("device_back")) == 0
    assert listener.wait("waiting", **{"for": "the port"}).level == "warning"
    trial.board.replug()
    assert listener.wait("device_back").fields["path"] == trial.link
    wait_for("ready again", lambda: len(listener.of("ready")) == 2)
    assert (len(listener.of("device_lost")), len(listener.of("device_back"))) == (1, 1)


def test_a_deaf_board_is_told_of_as_such(trial: Trial, listener: Listener) -> None:
    listener.wait("link", state="alive")
    trial.board.deaf(True)
    assert listener.wait("link", state="deaf").level == "critical"
    trial.board.deaf(False)
    wait_for("alive again", lambda: len(listener.of("link", state="alive")) == 2)


def test_the_pad_s_mode(trial: Trial, listener: Listener) -> None:
    trial.board.pad(0x2000)
    listener.wait("pad", mode="drive", process="telemetry")
    trial.robot.estop()
    listener.wait("pad", mode="locked")


def test_the_log_ends_with_its_service(trial: Trial, listener: Listener) -> None:
    trial.enable()
    listener.wait("enabled")
    trial.leave()
    assert trial.service.end() == 0
    ended = reading(listener)
    with pytest.raises(NoService, match="failstop run"):
        wait_for("the end", ended)
    kinds = [event.kind for event in listener.heard]
    assert [kind for kind in kinds if kind in ("stopping", "stopped")] == ["stopping", "stopped"]
    assert kinds[-1] == "stopped"
    with pytest.raises(NoService):
        EventLog(trial.name)


def test_a_log_of_a_run_that_was_followed_by_another_says_so(trial: Trial, listener: Listener) -> None:
    listener.wait("ready")
    trial.service.kill()
    trial.service.start()
    with pytest.raises(NoService, match="was restarted"):
        wait_for("the end", reading(listener))
    new = Listener(trial)
    new.wait("ready")
    assert new.heard[0].seq == 1
    assert new.heard[0].t > listener.heard[-1].t


def reading(listener: Listener) -> Callable[[], bool]:
    """Reads on and is never satisfied."""

    def check() -> bool:
        listener.of("")
        return False

    return check


def test_a_driver_that_leaves_off(trial: Trial, listener: Listener) -> None:
    who = f"trial (pid {os.getpid()})"
    trial.enable()
    trial.drive(0.2)
    silent = listener.wait("driver_silent", who=who, source="cmd_vel")
    assert 300 <= float(silent.fields["silent_ms"]) < 1000
    assert f"{who} fell silent" in silent.text
    trial.drive(0.2)
    trial.leave()
    assert listener.wait("driver_ended", who=who, source="cmd_vel").level == "info"
    assert listener.of("driver_gone") == []
    assert listener.of("stop") == [], "none is a latched stop"


def turning(trial: Trial, robot: Robot) -> None:
    """The robot drives, by a person's commands."""

    def moving() -> bool:
        robot.drive(0.1, 0.0, 0.0, manual=True)
        return trial.moving()

    wait_for("the wheels to turn", moving)


def crash(robot: Robot) -> None:
    with robot:
        raise ZeroDivisionError


def interrupt(robot: Robot) -> None:
    with robot:
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("leave", "error", "kind", "level"),
    [
        (crash, ZeroDivisionError, "driver_gone", "warning"),
        (interrupt, KeyboardInterrupt, "driver_ended", "info"),
    ],
)
def test_an_error_that_ends_a_driver_is_no_ordinary_end(
    trial: Trial,
    listener: Listener,
    leave: Callable[[Robot], None],
    error: type[BaseException],
    kind: str,
    level: str,
) -> None:
    trial.enable()
    robot = Robot(trial.name, client="nav")
    turning(trial, robot)
    with pytest.raises(error):
        leave(robot)
    assert listener.wait(kind, who=f"nav (pid {os.getpid()})").level == level
    assert len(listener.of("driver_gone") + listener.of("driver_ended") + listener.of("driver_silent")) == 1


def test_a_killed_driver_has_gone(trial: Trial, listener: Listener) -> None:
    trial.enable()
    code = (
        f"from failstop import Robot\nimport time\nrobot = Robot({trial.name!r}, client='mortal')\n"
        "while True: robot.drive(0.1, 0, 0, manual=True); time.sleep(0.02)"
    )
    client = subprocess.Popen([sys.executable, "-c", code])
    trial.board.wait_wheels(moving=True, timeout_s=10.0)
    client.kill()
    client.wait()
    assert listener.wait("driver_gone", who=f"mortal (pid {client.pid})").level == "warning"
    assert listener.of("driver_ended") == []


def test_failstop_drive_ends_in_its_own_words(trial: Trial, listener: Listener) -> None:
    trial.enable()
    trial.leave()
    assert failstop("drive", "0.1", "0", "0", "--for", "0.5", "--name", trial.name).returncode == 0
    ended = listener.wait("driver_ended", source="cmd_vel")
    assert re.fullmatch(r"failstop drive \(pid \d+\) ended its command: the wheels are stopped", ended.text)
    assert listener.of("driver_gone") + listener.of("driver_silent") == []
    said = failstop("status", "--name", trial.name).stdout + failstop("why", "--name", trial.name).stdout
    assert "while it drove" not in said


def test_a_key_that_is_let_go_is_told_as_that(trial: Trial, listener: Listener) -> None:
    trial.enable()
    robot = Robot(trial.name, client="teleop")
    turning(trial, robot)
    ended = listener.wait("driver_ended", source="cmd_vel")
    assert re.fullmatch(rf"teleop \(pid {os.getpid()}\) let go: last command \d+ ms ago, .*", ended.text)
    assert listener.of("driver_gone") + listener.of("driver_silent") == []
    robot.close()

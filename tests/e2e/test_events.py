"""Events by which the service tells of itself, as programs read them: kinds and fields, on a simulated machine."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from failstop.supervisor.kinds import EVENT_BY_NAME
from tests.support.simulated import FORWARD, Simulated


class Listener:
    """All events of a service, those included that came before it."""

    def __init__(self, simulated: Simulated) -> None:
        self._simulated = simulated
        self.log = simulated.load("failstop.api.events").EventLog(simulated.name)
        self.heard: list[Any] = []

    def of(self, kind: str, **fields: object) -> list[Any]:
        """The events of a kind with these fields, so far."""
        self.heard += self.log.read()
        return [e for e in self.heard if e.kind == kind and fields.items() <= e.fields.items()]

    def wait(self, kind: str, count: int = 1, **fields: object) -> Any:
        """The event that makes it so many, waited for."""
        self._simulated.wait_for(f"{kind} {fields}", lambda: len(self.of(kind, **fields)) >= count)
        return self.of(kind, **fields)[count - 1]


@pytest.fixture
def listener(simulated: Simulated) -> Iterator[Listener]:
    made = Listener(simulated)
    yield made
    for event in made.heard:
        kind = EVENT_BY_NAME[event.kind]
        assert set(kind.fields.split()) <= event.fields.keys(), event
    assert [event.seq for event in made.heard] == list(range(1, len(made.heard) + 1))
    assert [event.ns for event in made.heard] == sorted(event.ns for event in made.heard)


def test_from_the_start_to_a_stop_and_back(simulated: Simulated, listener: Listener) -> None:
    robot, pid = simulated.robot, simulated.pid
    assert listener.wait("ready").level == "notice"
    listener.wait("link", state="alive")
    robot.estop("too early")
    listener.wait("stop")
    with pytest.raises(simulated.failstop.Refused):
        robot.enable()
    listener.wait("refused", who="trial", pid=pid, verb="enable")
    simulated.enable()
    listener.wait("reset", who="trial", pid=pid)
    assert listener.wait("enabled", who="trial", pid=pid).text == f"motion enabled by trial (pid {pid})"
    robot.enable()
    robot.disable()
    listener.wait("disabled", who="trial")
    robot.disable()
    robot.enable()
    robot.estop("hand near wheel")
    stop = listener.wait("stop", 2)
    assert stop.fields["reason"] == f"stop request: hand near wheel (says it is trial, pid {pid})"
    assert stop.fields["noticed_by"] == "port_owner"
    assert stop.fields["written_by"] == "port owner"
    assert 0 < float(stop.fields["latency_us"]) < 1000
    assert stop.fields["epoch"] == robot.state.epoch
    outcome = listener.wait("stop_outcome", epoch=stop.fields["epoch"])
    assert float(outcome.fields["acknowledged_us"]) > 0
    assert outcome.fields["link"] == "alive"
    assert (len(listener.of("enabled")), len(listener.of("disabled"))) == (2, 1), "what changes nothing is not told"


def test_deaths_and_hangs(simulated: Simulated, listener: Listener) -> None:
    pids = simulated.pids()
    simulated.die("telemetry")
    listener.wait("died", process="telemetry", pid=pids["telemetry"], how="was killed by SIGKILL")
    listener.wait("restarting", process="telemetry")
    simulated.recover("telemetry", pids["telemetry"])
    simulated.suspend("stopper")
    fenced = listener.wait("fenced", process="stopper", pid=pids["stopper"])
    assert float(fenced.fields["silent_ms"]) >= 250
    assert 0 <= float(fenced.fields["kill_us"]) <= float(fenced.fields["gone_us"])


def test_a_port_that_goes_and_comes_back(simulated: Simulated, listener: Listener) -> None:
    simulated.board.unplug()
    assert listener.wait("device_lost").fields["path"] == simulated.link
    assert len(listener.of("device_back")) == 0
    assert listener.wait("waiting", 1, **{"for": "the port"}).level == "warning"
    simulated.board.replug()
    assert listener.wait("device_back").fields["path"] == simulated.link
    listener.wait("ready", 2)
    assert (len(listener.of("device_lost")), len(listener.of("device_back"))) == (1, 1)


def goes_on(listener: Listener) -> Callable[[], bool]:
    """Reads on and is never satisfied."""
    return lambda: bool(listener.of("nothing"))


def test_the_log_ends_with_its_service(simulated: Simulated, listener: Listener) -> None:
    simulated.enable()
    simulated.leave()
    assert simulated.end() == 0
    with pytest.raises(simulated.failstop.NoService, match="failstop run"):
        simulated.wait_for("the end", goes_on(listener))
    kinds = [event.kind for event in listener.heard]
    assert [kind for kind in kinds if kind in ("stopping", "stopped")] == ["stopping", "stopped"]
    assert kinds[-1] == "stopped"
    with pytest.raises(simulated.failstop.NoService):
        Listener(simulated)


def test_a_log_of_a_run_that_was_followed_by_another_says_so(simulated: Simulated, listener: Listener) -> None:
    listener.wait("ready")
    simulated.die("supervisor")
    simulated.recover("supervisor", 0)
    with pytest.raises(simulated.failstop.NoService, match="was restarted"):
        simulated.wait_for("the end", goes_on(listener))
    new = Listener(simulated)
    new.wait("ready")
    assert new.heard[0].seq == 1
    assert new.heard[0].t > listener.heard[-1].t


def test_who_follows_a_run_whose_supervisor_was_killed_shows_its_events_once(simulated: Simulated) -> None:
    """The other processes live on for a moment, here for 2 s, and until they have ended the run can be found."""
    passed: list[None] = []

    def each() -> None:
        passed.append(None)
        if len(passed) == 10:
            for name in ("port_owner", "stopper"):
                simulated.suspend(name)
            simulated.die("supervisor")
        if len(passed) == 110:
            simulated.lab.kill("events")

    _, out, err = simulated.command("events", "--follow", each=each)
    assert out.count("is ready") == 1
    assert err.count("waiting for it") == 1


# How a driver ends.


def one_end(listener: Listener, kind: str, level: str, **fields: str) -> Any:
    """The one event of a driver's end."""
    ended = listener.wait(kind, 1, **fields)
    assert ended.level == level
    told = [event for which in ("gone", "ended", "silent") for event in listener.of(f"driver_{which}")]
    assert told == [ended]
    assert listener.of("stop") == [], "none is a latched stop"
    return ended


@pytest.mark.parametrize(
    ("error", "kind", "level"),
    [(ZeroDivisionError, "driver_gone", "warning"), (KeyboardInterrupt, "driver_ended", "info")],
)
def test_an_error_that_ends_a_driver_is_no_ordinary_end(
    simulated: Simulated, listener: Listener, error: type[BaseException], kind: str, level: str
) -> None:
    simulated.enable()

    def fail() -> None:
        with simulated.failstop.Robot(client="nav") as robot:
            simulated.lab.drive(robot, 0.2, FORWARD)
            raise error

    with pytest.raises(error):
        fail()
    one_end(listener, kind, level, who=f"nav (pid {simulated.pid})")


def test_failstop_drive_ends_in_its_own_words(simulated: Simulated, listener: Listener) -> None:
    simulated.enable()
    simulated.leave()
    assert simulated.command("drive", "0.1", "0", "0", "--for", "0.5")[0] == 0
    ended = one_end(listener, "driver_ended", "info", source="cmd_vel")
    assert re.fullmatch(r"failstop drive \(pid \d+\) ended its command, so the wheels are told to stop", ended.text)
    assert "while it drove" not in simulated.printed("status") + simulated.printed("why")

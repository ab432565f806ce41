"""A stop of a moment ago: its file is waited for, and nobody is shown an older one as the last without a word."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.incidents import files
from failstop_lab.machine.files import Regular
from failstop_lab.machine.process import Process
from tests.support.incident_parts import drive_and_die
from tests.support.simulated import Simulated

FOLDER = "/var/lib/failstop/failstop/incidents"
OLDER = "20260921-143320-gate-died.incident"
NS = 1_000_000_000


@pytest.fixture
def service() -> Simulated:
    """A service that runs; the machine's saver saves nothing."""
    return Simulated()


@pytest.fixture
def command(service: Simulated) -> Any:
    """The module of `failstop incident`, on that machine."""
    return service.load("failstop.cli.commands.incident")


def saved(service: Simulated, after_s: float, name: str = OLDER) -> None:
    """An incident of a stop that came so long after the last one, saved while the clock was two years behind."""
    made, stop = drive_and_die(), service.robot.state.last_stop
    run = service.load("failstop.api.client").run("failstop")[0].rpartition(".")[2]
    head = made.head(unix_ns=round((stop.t - 6e7) * NS))
    head |= {"run": run, "cause_ns": stop.noticed_ns + round(after_s * NS)}
    file = Regular()
    file.put(files.build(head, made.body()), 0)
    service.lab.machine.root.folder(FOLDER).put(name, file)


def replace(service: Simulated, process: str) -> None:
    """Kill this process; returns when the service is whole again."""
    pid = service.pids()[process]
    service.die(process)
    service.recover(process, pid)


@pytest.mark.parametrize("reset", [False, True])
def test_a_stop_that_is_in_no_file(service: Simulated, command: Any, reset: bool) -> None:
    replace(service, "gate")
    if reset:
        service.robot.reset()
    stop = service.robot.state.last_stop
    assert command.unsaved("failstop") == stop
    saved(service, -30.0)
    assert command.unsaved("failstop") == stop, "that is another's file"
    saved(service, 0.002)
    assert command.unsaved("failstop") is None


def test_nothing_is_to_come(service: Simulated, command: Any) -> None:
    assert command.unsaved("nobody") is None
    assert command.unsaved("failstop") is None
    service.board.unplug()
    service.wait_for("the latch", lambda: service.robot.state.estop == "device lost")
    assert command.unsaved("failstop") is not None
    service.die("telemetry")
    service.wait_for("its stop", lambda: "restarting telemetry" in service.said)
    last = service.robot.state.last_stop
    assert (last.reason, last.written_s) == ("device lost", None)
    saved(service, 0.0)
    assert command.unsaved("failstop") is None, "the later one belongs to the file of the one that is latched"


def test_its_file_is_waited_for(service: Simulated) -> None:
    replace(service, "gate")
    saved(service, -30.0)
    newer = f"000001-{OLDER}"
    service.lab.machine.at(service.now_ns() + 2 * NS, lambda: saved(service, 0.0, newer))
    code, printed, errors = service.command("incident", "show")
    assert (code, errors) == (0, "")
    assert "Incident 000001-20260921-143320-gate-died\n" in printed


def test_an_older_one_is_not_shown_without_a_word(service: Simulated, command: Any) -> None:
    replace(service, "gate")
    saved(service, -30.0)
    began_ns = service.now_ns()
    code, printed, errors = service.command("incident", "show")
    assert service.now_ns() - began_ns == pytest.approx(3 * NS, abs=NS // 10)
    assert code == 0
    assert printed.startswith("Incident ")
    assert errors == "failstop: the last stop (gate died) is not saved yet; this incident is from before that\n"


def test_a_long_still_after_s_is_waited_for() -> None:
    service = Simulated(settings={"still.after_s": 4.0})
    replace(service, "gate")
    saved(service, -30.0)
    began_ns = service.now_ns()
    assert service.command("incident", "show")[0] == 0
    assert service.now_ns() - began_ns == pytest.approx(5.5 * NS, abs=NS // 10)


def test_where_nothing_is_saved_nothing_is_waited_for() -> None:
    service = Simulated(settings={"incidents.save": "off"})
    replace(service, "gate")
    saved(service, -30.0)
    began_ns = service.now_ns()
    code, printed, errors = service.command("incident", "show")
    assert service.now_ns() - began_ns < NS // 10
    assert (code, printed[:9]) == (0, "Incident ")
    said = 'the last stop (gate died) was not saved: incidents.save is "off"; this incident is from before that'
    assert errors == f"failstop: {said}\n"


@pytest.mark.parametrize(
    ("save", "said"),
    [
        ("on", "and is saved as an incident when the service is started again"),
        ("off", 'but is not saved, because incidents.save is "off"'),
    ],
)
def test_a_run_that_died_is_named_before_an_older_incident_is_shown(save: str, said: str) -> None:
    service = Simulated(settings={"incidents.save": save})
    replace(service, "gate")
    saved(service, 0.002)
    service.die("supervisor")
    service.wait(1.0)
    code, printed, errors = service.command("incident", "show")
    assert (code, printed[:9]) == (0, "Incident ")
    died = f"the last run died: its last minute is still in memory, {said}; this incident is from before that"
    assert " ".join(errors.split()) == f"failstop: {died}"


def test_a_run_whose_incident_was_not_saved_is_named_before_an_older_incident_is_shown(service: Simulated) -> None:
    replace(service, "gate")
    saved(service, 0.002)
    service.lab.machine.programs["saver.py"] = lambda process, argv: 1
    service.die("supervisor")
    service.recover("supervisor", 0)
    service.wait_for("the saver's end", lambda: "incident not saved" in service.said)
    code, printed, errors = service.command("incident", "show")
    assert (code, printed[:9]) == (0, "Incident ")
    assert errors.startswith("failstop: the run before this one: ")
    assert "its incident was not saved: the saver ended with code 1" in " ".join(errors.split())
    assert "the run before this one: " in " ".join(service.command("why")[1].split())


def kill_driver(service: Simulated) -> Process:
    """A driver that is killed while the wheels turn; motion is disabled for that, and nothing is latched."""

    def drive(failstop: Any) -> None:
        robot = failstop.Robot(client="driver.py")
        robot.enable()
        while True:
            robot.drive(0.1, 0, 0, manual=True)
            service.wait(0.02)

    driver = service.program("driver.py", drive)
    service.board.wait_wheels(turning=True)
    service.wait(0.1)
    service.lab.machine.kill(driver, 9)
    service.board.wait_wheels(turning=False)
    service.wait(0.1)
    assert service.robot.state.cause is None
    assert not service.robot.state.enabled
    return driver


@pytest.mark.parametrize("latched_before", [True, False])
def test_a_stop_that_has_no_incident_is_named_before_an_older_one_is_shown(
    service: Simulated, latched_before: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The machine knows no statvfs().
    monkeypatch.setattr(service.load("failstop.files.durable"), "no_room", lambda _: "")
    if latched_before:
        replace(service, "gate")
        saved(service, 0.002)
        service.robot.reset()
    driver = kill_driver(service)
    code, printed, errors = service.command("incident", "show")
    told = " ".join(errors.split())
    why = f"motion was disabled: driver.py (pid {driver.pid}) died after it had driven; that is not a latched stop"
    assert f" {why}, so it has no incident" in told
    assert ("this incident is from before that" in told) == latched_before == (code == 0)
    assert printed.startswith("Incident ") == latched_before


def test_a_latched_stop_after_a_driver_s_death_is_shown_without_a_word(service: Simulated) -> None:
    kill_driver(service)
    service.leave()
    replace(service, "gate")
    saved(service, 0.002)
    code, printed, errors = service.command("incident", "show")
    assert (code, errors) == (0, "")
    assert printed.startswith("Incident ")


def test_a_stop_that_is_asked_for_while_the_port_is_lost_keeps_the_proofs_of_the_latched_one(
    service: Simulated,
) -> None:
    service.set_off()
    service.board.unplug()
    service.wait_for("the latch", lambda: service.robot.state.estop == "device lost")
    noticed_ns = service.robot.state.last_stop.noticed_ns
    assert service.command("stop", "somebody", "pulled", "the", "plug")[0] == 1
    assert service.robot.state.last_stop.reason == "device lost"
    service.board.replug()
    service.wait_for("an answer", lambda: service.robot.state.last_stop.acknowledged_s is not None)
    stop = service.robot.state.last_stop
    assert (stop.reason, stop.noticed_ns) == ("device lost", noticed_ns)
    assert service.robot.why().since == stop.t


def test_the_proof_of_an_earlier_stop_is_not_given_for_a_driver_s_death(service: Simulated) -> None:
    replace(service, "gate")
    service.robot.reset()
    assert "the last stop (gate died; " in service.robot.why().proof
    driver = kill_driver(service)
    why = service.robot.why()
    assert f"driver.py (pid {driver.pid}) died after it had driven" in why.what
    assert why.proof.startswith("the board is told to stop; the board answers; this stop was not timed")
    assert "gate died" not in str(why)
    assert " after " not in why.proof

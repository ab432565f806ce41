"""Following a service through its restarts; one whose supervisor was killed: what is said of it before it is started
again, and after."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop import instances
from failstop.api import host
from failstop.api.errors import NoService
from failstop.api.follow import CHECK_S, Follower
from failstop.cli.commands.status import Live
from failstop.files import instance
from failstop.fleet import publisher
from failstop.incidents import left
from failstop.messages import layout, segments
from failstop_lab.trial import Trial, state_in, wait_for
from tests.support.commands import failstop
from tests.support.shared_trial import IMU_HZ

SECONDS = 20


@pytest.fixture(scope="module")
def trial() -> Iterator[Trial]:
    with Trial(f"left-{os.getpid()}", imu_hz=IMU_HZ) as running:
        yield running


def run(trial: Trial, *words: str) -> subprocess.CompletedProcess[str]:
    return failstop(*words, "--name", trial.name, timeout=SECONDS)


def said(text: str) -> str:
    return " ".join(text.split())


def test_a_killed_supervisor(trial: Trial) -> None:
    assert left.left(trial.name) is None, "it runs"
    trial.enable()
    trial.drive(0.3)
    pid = trial.service.pids()["supervisor"]
    trial.leave()
    trial.service.kill()
    wait_for("its stop", lambda: (found := left.left(trial.name)) is not None and "wrote" in found[0].proof)
    wait_for("its end", lambda: run(trial, "status").returncode == 3)
    start = f"`failstop run --name {trial.name} --device {trial.board.link}`"
    status, why, events = (run(trial, word) for word in ("status", "why", "events"))
    assert (status.returncode, status.stdout, status.stderr.count("\n")) == (3, "", 1)
    assert "supervisor died (" in status.stderr
    assert re.search(r" wrote the stop \d{1,3}(\.\d+)? [um]s later", said(status.stderr))
    assert f"next: {start}" in status.stderr
    assert (why.returncode, why.stderr) == (3, "")
    assert f"supervisor died (pid {pid};" in said(why.stdout)
    assert f"do {start}, then `failstop incident show last --name {trial.name}`" in said(why.stdout)
    assert json.loads(run(trial, "why", "--json").stdout)["do"][0] == start
    assert events.returncode == 3
    assert left.SAVED_LATER in run(trial, "incident", "show").stderr
    assert "motion enabled by trial" in events.stdout, "its memory still has what it told"

    trial.service.start()
    wait_for("the incident", lambda: "incident show" in run(trial, "status").stdout)
    status, why = run(trial, "status"), run(trial, "why")
    assert "the run before this one: supervisor died (`failstop incident show " in said(status.stdout)
    assert f"-supervisor-died --name {trial.name}`" in said(why.stdout)
    assert left.left(trial.name) is None


def test_the_printed_stop_stops_the_board_of_the_dead_run() -> None:
    """No stop was written, and the board is not of the kind that is assumed without settings."""
    with Trial(f"left-kind-{os.getpid()}", kind="arduino") as trial:
        trial.enable()
        trial.drive(0.5)
        assert trial.turning()
        pids = trial.service.pids()
        trial.leave()
        trial.service.signal_known(signal.SIGSTOP)
        wait_for("all to be frozen", lambda: all(state_in(f"/proc/{pid}/stat") == "T" for pid in pids.values()))
        trial.service.kill_known()
        wait_for("its end", trial.service.gone)
        why = run(trial, "why")
        assert why.stdout.startswith("what   THE WHEELS MAY TURN")
        step = json.loads(run(trial, "why", "--json").stdout)["do"][0]
        assert step == f"`failstop stop --name {trial.name}` if the wheels turn"
        screen = "".join(text for line in Live(trial.name).gone("", 200) for text, _ in line)
        assert step.split("`")[1] in screen
        stop = failstop(*step.split("`")[1].split()[1:], timeout=SECONDS)
        assert (stop.returncode, stop.stderr) == (0, "")
        assert not trial.turning()


def test_the_fleet_gets_each_event_of_a_run_once(trial: Trial) -> None:
    """Until the last processes of a run whose supervisor was killed have ended, the run can still be found."""
    service = publisher.Service(trial.name)
    found = service.events()
    others = [pid for name, pid in trial.service.pids().items() if name in (layout.PORT_OWNER, layout.STOPPER)]
    trial.leave()
    for pid in others:
        os.kill(pid, signal.SIGSTOP)
    trial.service.kill()
    for _ in range(5):
        service.read()
        found += service.events()
    for pid in others:
        os.kill(pid, signal.SIGCONT)
    wait_for("its end", lambda: run(trial, "status").returncode == 3)
    trial.service.start()
    assert [event.kind for event in found].count("ready") == 1
    assert [event.kind for event in service.events()].count("ready") == 1, "of the new run"


def test_with_a_unit_it_is_systemd_that_starts_it(installed: Callable[[str], None]) -> None:
    error = NoService("none")
    assert left.refusal("nobody-here", error) is error
    installed("failstop@.service")
    told = str(left.refusal("nobody-here", error))
    assert "start it with `sudo systemctl start failstop@nobody-here`" in told
    assert "`journalctl -u failstop@nobody-here -e`" in told


@pytest.mark.parametrize("name", ["failstop", "left-arm"])
@pytest.mark.usefixtures("installed")
def test_a_unit_counts_where_systemd_runs_and_has_it(name: str, tmp_path: Path) -> None:
    units = tmp_path / "etc/systemd/system"
    units.mkdir(parents=True)
    (units / ("failstop.service" if name == "failstop" else "failstop@.service")).touch()
    assert host.unit(name) == "", "systemd does not run"
    (tmp_path / "run/systemd/system").mkdir(parents=True)
    assert host.unit(name) == ("failstop" if name == "failstop" else "failstop@left-arm")
    assert host.unit("failstop" if name != "failstop" else "left-arm") == "", "that one is not installed"


@pytest.mark.usefixtures("installed")
def test_commands_name_what_is_not_the_usual() -> None:
    assert host.stop("failstop") == "`failstop stop`"
    assert host.stop("left") == "`failstop stop --name left`"
    assert host.start("failstop") == "`failstop run`"
    assert host.start("left") == "`failstop run --name left`"
    assert host.journal("left") == ""


def test_what_starts_it_is_what_started_it_the_last_time(installed: Callable[[str], None]) -> None:
    installed("failstop@.service")
    assert host.start("left") == "`sudo systemctl start failstop@left`"
    command = "failstop run --name left --config '/home/me/my robot.toml'"
    instance.remember(instances.make_runtime_dir("left"), instance.Last("/dev/ttyACM1", command))
    assert host.start("left") == f"`{command}`", "by hand, though there is a unit"
    assert host.start("right") == "`sudo systemctl start failstop@right`"


def test_an_end_and_a_start_anew(trial: Trial) -> None:
    """One that looks meanwhile is told that nothing is there; one that does not notices that it is another run, though
    the memory of the old one can still be read."""
    often, seldom = Follower(trial.name), Follower(trial.name)
    before = seldom.read(0.0)
    assert before is not None
    trial.leave()
    assert trial.service.end() == 0
    assert left.left(trial.name) is None
    for word in ("status", "why"):
        done = run(trial, word)
        assert (done.returncode, done.stdout) == (3, "")
        assert f"`failstop run --name {trial.name} --device {trial.board.link}`" in done.stderr
    assert often.read(10.0) is None
    assert "no service named" in often.note
    assert often.absent
    trial.service.start()
    assert often.events
    soon = often.read(10.0)
    assert soon is not None
    assert {event.t for event in often.events}.isdisjoint(event.t for event in seldom.events), "they are of this run"
    after = seldom.read(CHECK_S)
    assert after is not None
    assert after.processes[layout.SUPERVISOR].pid == trial.service.pids()[layout.SUPERVISOR]
    assert after.run == soon.run != before.run


def test_a_service_of_another_version_is_not_said_to_be_absent(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    follower = Follower(trial.name)
    trial.leave()
    assert trial.service.end() == 0
    trial.service.start()
    monkeypatch.setattr(segments, "LAYOUT_HASH", layout.LAYOUT_HASH ^ 1)
    assert follower.read(10.0) is None
    assert not follower.absent
    screen = "\n".join(
        "".join(text for text, _ in line) for line in Live(trial.name).gone(follower.note, 100, absent=False)
    )
    assert "CAN'T READ" in screen
    assert "NO SERVICE" not in screen
    assert "failstop run" not in screen
    assert f"failstop stop --name {trial.name}" in screen


def test_there_must_be_one_at_first() -> None:
    with pytest.raises(NoService):
        Follower("nobody-here")

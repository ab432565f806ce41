"""The real service on a simulated board: each stop leaves one file, and whatever hinders that hinders nothing else."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import psutil
import pytest

from failstop.api.events import EventLog
from failstop.cli.main import main
from failstop.incidents import files, story
from failstop.incidents.incident import Incident, WriteSort
from failstop.messages import layout
from failstop_lab.trial import Trial, wait_for
from tests.support.shared_trial import patient

pytestmark = pytest.mark.slow
IMU_HZ = 60.0
SAVED_S = 20.0


class Kept:
    """A trial, and the incidents of one test of it: those that were not there when it began."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.environ = {"STATE_DIRECTORY": trial.state}
        self._before: set[str] = set()
        self._log = EventLog(trial.name)
        self._told: list[str] = []

    def begin(self) -> None:
        """Wait until the service is whole and at rest, and saves nothing any more."""
        wait_for("a service that is whole", self.trial.service.ready)
        self.trial.enable()
        self.trial.robot.disable()
        self.trial.board.wait_wheels(turning=False, timeout_s=5.0)
        self.rest()
        self._before = set()
        self._before = {str(head["id"]) for head in self.heads()}
        self._log = EventLog(self.trial.name)
        self._log.read()
        self._told.clear()

    def rest(self) -> None:
        wait_for("the end of every saver", lambda: not self._savers(psutil.process_iter()), SAVED_S)

    def heads(self) -> list[dict[str, object]]:
        found, problems = files.heads(self.trial.name, files.folders(self.trial.name, self.environ))
        assert problems == []
        return [head for head in found if head["id"] not in self._before]

    def saved(self, count: int = 1) -> Incident:
        """The newest, once there are so many."""
        wait_for(f"{count} incidents", lambda: len(self.heads()) >= count, SAVED_S)
        assert len(self.heads()) == count
        return Incident.read(files.find("last", self.trial.name, self.environ))

    def told(self) -> list[str]:
        """The words on incidents, of the run in which the test began."""
        self._told += [event.text for event in self._log.read() if event.kind == "incident"]
        return self._told

    def folder(self) -> Path:
        return Path(self.trial.state) / "incidents"

    def _savers(self, among: Iterable[psutil.Process]) -> list[psutil.Process]:
        found = []
        for process in among:
            with contextlib.suppress(psutil.NoSuchProcess):
                words = process.cmdline()
                if any(word.endswith("incidents/saver.py") for word in words) and f"name={self.trial.name}" in words:
                    found.append(process)
        return found

    def saver(self) -> psutil.Process:
        supervisor = psutil.Process(self.trial.service.pids()[layout.SUPERVISOR])
        found: list[psutil.Process] = []
        wait_for("a saver", lambda: found.extend(self._savers(supervisor.children())) or found, SAVED_S)
        return found[0]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kept]:
    """Every test leaves it whole, or begin() waits until it is."""
    with Trial(f"box-{os.getpid()}", patient(tmp_path_factory.mktemp("box")), imu_hz=IMU_HZ) as trial:
        yield Kept(trial)


@pytest.fixture
def kept(service: Kept) -> Kept:
    service.begin()
    return service


def test_a_stop_request_and_then_a_killed_gate(
    kept: Kept, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = kept.trial
    trial.enable()
    trial.drive(1.0)
    trial.robot.estop("the test says so")
    trial.drive(0.1)
    monkeypatch.setenv("STATE_DIRECTORY", trial.state)
    assert main(["incident", "show", "--name", trial.name]) == 0
    assert "the test says so" in capsys.readouterr().out, "whoever asks for the last means this one"
    first = kept.saved()
    assert first.reason.startswith("stop request: the test says so")
    check_driven(first)
    assert first.head["stop"]["acknowledged_us"] > 0
    assert next(event.kind for event in first.events if event.ns > first.cause_ns) == "stop"

    trial.enable()
    pid = trial.service.pids()["gate"]
    assert trial.kill("gate", 0.5).stop_ns is not None
    trial.recover("gate", pid)
    second = kept.saved(2)
    assert second.reason == "gate died"
    check_driven(second)
    assert any(line.text.startswith("! gate (pid ") and line.text.endswith("SIGKILL") for line in story.whole(second))
    assert second.ticks[-1].ns > second.cause_ns, "the successor writes where the dead gate ended"
    ids = (first.id, second.id)
    wait_for("words on both", lambda: len(kept.told()) == 2, SAVED_S)
    shown = [f"`failstop incident show {one} --name {trial.name}`" for one in ids]
    assert kept.told() == [f"incident {one} saved; next: {todo}" for one, todo in zip(ids, shown, strict=True)]


def test_the_death_of_the_one_who_decodes_loses_nothing_of_before(kept: Kept) -> None:
    trial = kept.trial
    trial.enable()
    pid = trial.service.pids()["telemetry"]
    assert trial.kill("telemetry", 1.0).stop_ns is not None
    trial.recover("telemetry", pid)
    saved = kept.saved()
    assert saved.reason == "telemetry died"
    before = [sample for sample in saved.imu if saved.cause_ns - 1_000_000_000 < sample.t_ns < saved.cause_ns]
    assert len(before) > IMU_HZ / 2
    assert [tick for tick in saved.ticks if tick.ns < saved.cause_ns][-1].block == "driving"
    assert any(line.what == story.CAUSE for line in story.whole(saved))


def check_driven(incident: Incident) -> None:
    """Check what is in it: before, commands, decisions, frames, IMU, bytes; then the burst, and what followed for about
    2 s."""
    before = [tick for tick in incident.ticks if tick.ns < incident.cause_ns]
    assert before[-1].block == "driving"
    assert before[-1].who.startswith("trial (pid ")
    assert before[-1].velocity[0] > 0.05
    bursts = [w for w in incident.writes if w.sort == WriteSort.STOP_BURST and w.ns >= incident.cause_ns]
    assert bursts[0].by == layout.PORT_OWNER
    assert incident.head["stop"]["written_us"] >= 0
    motion_after = [w for w in incident.writes if w.sort == WriteSort.MOTION and w.ns > bursts[0].ns]
    assert motion_after == []
    end_ns = incident.span_ns[1]
    assert 1900 < incident.ms(end_ns) < 10_000
    for times in ([ns for ns, _ in incident.received], [sample.t_ns for sample in incident.imu]):
        assert times[0] < incident.cause_ns - 400_000_000, "before"
        assert times[-1] > incident.cause_ns + 1_500_000_000, "and after"
    assert incident.undecoded == 0
    assert any(line.what == story.CAUSE for line in story.whole(incident))


def test_a_port_that_is_gone_for_longer_than_a_stop_is_watched(kept: Kept) -> None:
    trial = kept.trial
    trial.enable()
    trial.drive(0.5)
    trial.board.unplug()
    kept.saver()
    wait_for("the latch", lambda: trial.robot.state.estop == "device lost", 5.0)
    since_s = time.monotonic()
    wait_for("longer than a stop is watched", lambda: time.monotonic() - since_s > 3.0, 10.0)
    assert kept.heads() == []
    trial.board.replug()
    incident = kept.saved()
    stop = incident.head["stop"]
    assert incident.reason == "device lost"
    assert stop["written_by"] == "supervisor"
    assert 3e6 < stop["written_us"] < 12e6
    assert stop["acknowledged_us"] > stop["written_us"]
    assert any(event.kind == "device_back" for event in incident.events)


def test_a_supervisor_that_dies_while_a_stop_is_being_saved(kept: Kept) -> None:
    """Two stories: the stop's, saved at once by the saver that was there, and the death's, by the next start."""
    trial = kept.trial
    trial.robot.estop("and then it got worse")
    kept.saver()
    trial.leave()
    trial.service.kill()
    assert kept.saved().reason.startswith("stop request: and then it got worse")
    word = f"failstop: the supervisor is gone; its saver says: incident {kept.saved().id} saved\n"
    wait_for("the saver's word", lambda: word in trial.service.said(), SAVED_S)
    assert "Traceback" not in trial.service.said()
    trial.service.start()
    wait_for("the second", lambda: len(kept.heads()) == 2, SAVED_S)
    assert {str(head["kind"]) for head in kept.heads()} == {"stop", "left"}


def test_a_stop_just_before_the_end_of_the_service_is_saved(kept: Kept) -> None:
    trial = kept.trial
    trial.robot.estop("the last word")
    wait_for("the latch", lambda: bool(trial.robot.state.estop), 5.0)
    trial.leave()
    assert trial.service.end() == 0
    incident = kept.saved()
    assert incident.reason.startswith("stop request: the last word")
    trial.service.start()
    kept.rest()
    assert len(kept.heads()) == 1, "an orderly end leaves nothing to save"


def test_a_killed_saver_and_a_folder_that_is_none(
    kept: Kept, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = kept.trial
    kept.folder().mkdir(parents=True, exist_ok=True)
    half = kept.folder() / ".draft-1999999999"
    half.write_bytes(b"half of it")
    trial.robot.estop("first")
    kept.saver().kill()
    wait_for("a word on it", lambda: len(kept.told()) == 1, SAVED_S)
    assert kept.told()[0].startswith("incident not saved: the saver was killed by signal 9; next: ")
    assert kept.heads() == []

    trial.robot.reset()
    shutil.move(kept.folder(), kept.folder().with_suffix(".away"))
    kept.folder().write_text("in the way")
    trial.robot.estop("second")
    wait_for("a word on that", lambda: len(kept.told()) == 2, SAVED_S)
    assert kept.told()[1].startswith("incident not saved: [Errno 17] File exists")
    monkeypatch.setenv("STATE_DIRECTORY", trial.state)
    assert main(["incident", "show", "--name", trial.name]) == 1
    told = capsys.readouterr().err
    assert "failstop: the last stop (stop request: second " in told
    assert ") was not saved: [Errno 17] File exists" in told
    assert f"no incident of '{trial.name}' is saved" in told

    trial.robot.reset()
    kept.folder().unlink()
    shutil.move(kept.folder().with_suffix(".away"), kept.folder())
    trial.robot.estop("third")
    assert kept.saved().reason.startswith("stop request: third")
    assert not half.exists()
    assert trial.robot.state.estop is not None

"""The name of a run comes last: a client that finds it can believe at once all that it reads, and notices the run's end
whatever moment it came at."""

from __future__ import annotations

import itertools
import os
import pty
import shutil
from collections.abc import Callable, Iterator

import pytest

from failstop import NoService, Robot, State, instances
from failstop.api.client import Run as Found
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.policy.settings import Settings
from failstop.procs.world import World
from failstop.shm import instance, layout, segment
from failstop.supervisor import entry
from failstop.supervisor.main import Supervisor
from failstop.supervisor.port import OwnPort
from failstop.supervisor.run import Run
from failstop.supervisor.status import Notify

_numbers = itertools.count()
SET = {"device.path": "/dev/board", "interlocks.seat.timeout_s": 1.0}


class Service:
    """The runs of a service before their first process is started; their supervisor is this process."""

    def __init__(self) -> None:
        self.name = f"last{os.getpid()}x{next(_numbers)}"
        self.directory = instances.make_runtime_dir(self.name)
        self._runs: list[Run] = []
        self._supervisors: list[Supervisor] = []
        self._ports = pty.openpty()

    def make(self) -> Run:
        """All of a run but its name."""
        self._runs.append(Run(World(), Settings(SET), self.name, self.directory))
        return self._runs[-1]

    def start(self) -> Run:
        """A run that can be found."""
        made = self.make()
        self._supervisors.append(entry._found(made, OwnPort(self._ports[1]), Notify()))
        return made

    def die(self, run: Run) -> None:
        """As by SIGKILL: all that a dying process lets go of is its descriptors, and what it has made stays."""
        for made in run._segments:
            made.close()

    def close(self) -> None:
        for supervisor in self._supervisors:
            for control in supervisor.handover.controls.values():
                control.close()
            os.close(supervisor.handover.opener._spare)
            os.close(supervisor.processes.early.bell.fd)
            os.close(supervisor._run.published)
        for run in self._runs:
            run.remove()
            fds = (run.stop_pipe, run.client_bell, *(bell.fd for bell in run.bells.values()))
            for fd in (*fds, *(pair[1] for pair in run.controls.values())):
                os.close(fd)
        for fd in self._ports:
            os.close(fd)
        shutil.rmtree(self.directory)


@pytest.fixture
def service() -> Iterator[Service]:
    made = Service()
    yield made
    made.close()


def at_the_name(monkeypatch: pytest.MonkeyPatch, look: Callable[[], None]) -> None:
    """Look when the name has just been published, and nothing else has happened since."""
    publish = instance.publish

    def published(runtime_dir: str, incarnation: int) -> int:
        fd = publish(runtime_dir, incarnation)
        look()
        return fd

    monkeypatch.setattr(instance, "publish", published)


def test_all_that_a_client_reads_is_there_when_the_name_is(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[State] = []

    def look() -> None:
        reader = StateReader(service.name)
        assert not reader.over()
        assert reader.settings() == Settings(SET).flat()
        reader.check("interlock", "seat")
        reader.check("source", "cmd_vel")
        assert EventLog(service.name).read() == []
        with Robot(service.name, client="early") as robot:
            seen.append(robot.state)
            assert not robot.drive(0.1, 0.0, 0.0, manual=True)
            robot.sensed()

    at_the_name(monkeypatch, look)
    service.start()
    (state,) = seen
    assert state.processes[layout.SUPERVISOR].pid == os.getpid()
    assert set(state.processes) == set(layout.PROCESSES)
    assert state.waiting_for == "port_owner, stopper, gate, telemetry"
    assert (state.enabled, state.blocked, state.cause) == (False, "disabled", None)
    assert (state.device.path, state.device.state, state.device.link) == ("/dev/board", "open", "unproven")


def test_nothing_is_found_before_the_name(service: Service) -> None:
    service.make()
    for find in (StateReader, EventLog, Found):
        with pytest.raises(NoService):
            find(service.name)
    robot = Robot(service.name)
    with pytest.raises(NoService):
        _ = robot.state


def test_nor_is_a_dead_run_found_under_the_pipes_of_the_next(service: Service) -> None:
    service.die(service.start())
    service.make()
    for find in (StateReader, EventLog, Found):
        with pytest.raises(NoService):
            find(service.name)


def test_a_run_that_dies_with_nothing_but_its_name_lets_its_clients_go(service: Service) -> None:
    first = service.start()
    robot, log, reader = Robot(service.name), EventLog(service.name), StateReader(service.name)
    assert robot.state.cause is None
    service.die(first)
    assert reader.over()
    with pytest.raises(NoService):
        log.read()
    second = service.start()
    assert robot.state.cause is None
    assert robot._current().found[0] == second.memory != first.memory
    assert EventLog(service.name)._run.found[0] == second.memory


def test_a_robot_that_was_made_at_the_name_follows_the_next_run(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Robot] = []
    at_the_name(monkeypatch, lambda: made.append(Robot(service.name)))
    first = service.start()
    assert [robot._current().found[0] for robot in made] == [first.memory]
    service.die(first)
    second = service.start()
    assert [robot._current().found[0] for robot in made] == [second.memory] * 2


def test_a_supervisor_that_can_t_begin_leaves_nothing_but_the_memory_of_the_run_before(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    service.die(dead := service.start())

    def begin(*_: object) -> Supervisor:
        raise OSError(24, os.strerror(24))

    monkeypatch.setattr(entry, "Supervisor", begin)
    with pytest.raises(OSError, match="Too many open files"):
        service.start()
    assert os.listdir(service.directory) == ["last"], "how the run before was started"
    assert segment.dead_runs(service.name) == [dead.memory]


def test_a_program_that_has_closed_every_descriptor_finds_its_run_again(service: Service) -> None:
    run = service.start()
    robot = Robot(service.name)
    reader = robot._current()
    os.close(reader._life)
    assert reader.over()
    assert robot.state.cause is None
    assert robot._current().found[0] == run.memory


def test_the_name_goes_first(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    run = service.start()
    unlink = segment.unlink
    found: list[bool] = []

    def gone(memory: str, name: str) -> None:
        found.append(os.path.exists(instance.run_path(service.directory)) or not segment.living(run.memory))
        unlink(memory, name)

    with monkeypatch.context() as patch:
        patch.setattr(segment, "unlink", gone)
        run.remove()
    assert found
    assert not found[0], "its memory is there, and its supervisor lives, while it can be found"

"""The name of a run comes last: a client that finds it can believe at once all that it reads, and notices the run's end
whatever moment it came at."""

from __future__ import annotations

import errno
import os
from typing import Any

import pytest

from failstop.messages import layout
from failstop_lab.machine.kernel import FOREVER_NS, SIGTERM
from failstop_lab.machine.process import Process, Thread
from failstop_lab.machine.robot import DEVICE, MS, Robot

DIRECTORY = "/run/failstop/failstop"
SUPERVISOR = 1 + len(layout.PROCESS_NAMES)
"""How many eventfds a supervisor makes before it can begin: a bell each, and one for the early news."""


class Service:
    """The runs of a service on a machine of which the test is a client."""

    def __init__(self) -> None:
        self.robot = Robot(settings={"interlocks.seat.timeout_s": 1.0})
        self.machine, self.load = self.robot.machine, self.robot.loader.load
        self.me = self.machine.join("client", {"HOME": "/root"})
        self.robot.streams(self.me)
        self.os = self.robot.loader.system["os"]
        self.failstop = self.load("failstop")
        self.find = (
            self.load("failstop.api.state").StateReader,
            self.load("failstop.api.events").EventLog,
            self.load("failstop.api.client").SeenRun,
        )
        self.read_state, self.read_events, _ = self.find

    def start(self, call: str = "rename", about: str = "run.new", *, after: bool = True) -> Process:
        """Start a run, which is held up at this call of the system, or just after it: when it has its name."""
        self.process = self.robot.start()
        self.hold_up(call, about, after=after)
        return self.process

    def hold_up(self, call: str, about: str, *, after: bool = False) -> None:
        """Let the supervisor run until it makes this call."""
        process, made = self.process, [not after]

        def at_seam(thread: Thread, name: str, given: tuple[Any, ...]) -> None:
            if thread.process is not process:
                return
            if made[0] and (after or self._is(call, about, name, given)):
                self.machine.at_seam = None
                self.machine.hold(process, FOREVER_NS)
            made[0] = made[0] or self._is(call, about, name, given)

        self.machine.at_seam = at_seam
        assert self.machine.run(lambda: process.held_until_ns > 0, 5_000 * MS)

    @staticmethod
    def _is(call: str, about: str, name: str, given: tuple[Any, ...]) -> bool:
        return name == call and about in str(given[0])

    def die(self) -> None:
        """As by SIGKILL: all that a dying process lets go of is its descriptors, and what it has made stays."""
        self.machine.die(self.process, -9)
        self.machine.run(lambda: self.process.code is not None, MS)

    def memory(self) -> str:
        """Of the run that has the name."""
        incarnation, _ = self.load("failstop.files.instance").current_run(DIRECTORY)
        found: str = self.load("failstop.messages.segments").memory("failstop", incarnation)
        return found

    def serves(self, robot: Any) -> bool:
        """Whether a Robot follows the run that was started last."""
        pid: int = robot.state.processes[layout.SUPERVISOR].pid
        return pid == self.process.pid

    def finds_nothing(self) -> None:
        for find in self.find:
            with pytest.raises(self.failstop.NoService):
                find("failstop")


@pytest.fixture
def service() -> Service:
    return Service()


def test_all_that_a_client_reads_is_there_when_the_name_is(service: Service) -> None:
    service.start()
    reader = service.read_state("failstop")
    assert not reader.over()
    assert reader.settings()["interlocks.seat.timeout_s"] == 1.0
    reader.check("interlock", "seat")
    reader.check("source", "cmd_vel")
    assert service.read_events("failstop").read() == []
    with service.failstop.Robot(client="early") as robot:
        state = robot.state
        assert not robot.drive(0.1, 0.0, 0.0, manual=True)
        robot.sensed()
    assert state.processes[layout.SUPERVISOR].pid == service.process.pid
    assert set(state.processes) == set(layout.PROCESS_NAMES)
    assert state.waiting_for == "port_owner, stopper, gate, telemetry"
    assert service.machine.now_ns > 60_000 * MS
    assert max(process.age_s for process in state.processes.values()) < 1.0, "not since the machine's start"
    assert (state.enabled, state.blocked, state.cause) == (False, "disabled", None)
    assert (state.device.path, state.device.state, state.device.link) == (DEVICE, "open", "unproven")


def test_nothing_is_found_before_the_name(service: Service) -> None:
    service.start(after=False)
    service.finds_nothing()
    robot = service.failstop.Robot()
    with pytest.raises(service.failstop.NoService):
        _ = robot.state


def test_a_dead_run_is_not_found_under_the_pipes_of_the_next(service: Service) -> None:
    service.start()
    service.die()
    service.start(after=False)
    service.finds_nothing()


def test_a_run_that_dies_with_nothing_but_its_name_lets_its_clients_go(service: Service) -> None:
    service.start()
    robot, log, reader = service.failstop.Robot(), service.read_events("failstop"), service.read_state("failstop")
    assert robot.state.cause is None
    assert service.serves(robot)
    service.die()
    assert reader.over()
    with pytest.raises(service.failstop.NoService):
        log.read()
    service.start()
    assert service.serves(robot)
    assert service.read_events("failstop").read() == []


def test_a_robot_that_was_made_at_the_name_follows_the_next_run(service: Service) -> None:
    made: list[Any] = []
    for _ in range(2):
        service.start()
        made.append(service.failstop.Robot())
        assert all(map(service.serves, made))
        service.die()


def test_a_supervisor_that_can_t_begin_leaves_the_memory_of_the_run_before(service: Service) -> None:
    service.start()
    dead = service.memory()
    service.die()
    made: list[Process] = []

    def no_descriptor(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        made.extend([thread.process] * (call == "eventfd"))
        if call == "eventfd" and len(made) == SUPERVISOR:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    service.machine.at_seam = no_descriptor
    process = service.robot.start()
    service.machine.run(lambda: process.code is not None, 5_000 * MS)
    assert process.code == 1
    assert b"Too many open files" in b"".join(service.robot.stderr.heard)
    assert sorted(service.os.listdir(DIRECTORY)) == ["last", "lock"], "how the run before was started"
    assert service.load("failstop.messages.segments").dead_runs("failstop") == [dead]


def test_a_program_that_has_closed_every_descriptor_finds_its_run_again(service: Service) -> None:
    service.start()
    robot, reader = service.failstop.Robot(), service.read_state("failstop")
    assert service.serves(robot)
    for fd in set(service.me.files) - {0, 1, 2}:
        service.os.close(fd)
    assert reader.over()
    assert robot.state.cause is None
    assert service.serves(robot)


def test_the_name_goes_first(service: Service) -> None:
    service.start()
    memory = service.memory()
    service.machine.resume(service.process)
    service.machine.run(lambda: service.robot.named(layout.GATE) is not None, 1_000 * MS)
    service.machine.kill(service.process, SIGTERM)
    service.hold_up("unlink", memory)
    assert not service.os.path.exists(f"{DIRECTORY}/run")
    assert service.load("failstop.messages.segments").living(memory), "its supervisor lives, while it can be found"

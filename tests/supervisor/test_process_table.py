"""The processes when the machine is short of something: no process that nobody watches, and it is tried again."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from failstop.board.interface import BOARD
from failstop.policy.settings import Settings
from failstop.procs.loop import NEVER, READ
from failstop.shm import layout, records
from failstop.shm.bell import EventBell
from failstop.shm.futex import BLOCKS
from failstop.shm.heartbeat import RUNNING
from failstop.shm.lifeline import Lifeline
from failstop.supervisor import starter
from failstop.supervisor.children import DIED, WAITING
from failstop.supervisor.process_table import TRY_AGAIN_NS
from tests.support.supervisor_scene import Scene


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


def test_a_process_that_can_not_be_watched_is_not_left_running(scene: Scene) -> None:
    started: list[int] = []

    def start(*_: object) -> int:
        started.append(os.posix_spawnp("sleep", ["sleep", "120"], os.environ))
        return started[-1]

    def no_descriptor(_pid: int) -> None:
        raise OSError(24, "Too many open files")

    processes = scene.supervisor.processes
    scene.world.play("spawn", start)
    scene.world.play("lifeline", no_descriptor)
    gate = processes[layout.GATE]
    processes.start(gate)
    (pid,) = started
    assert not os.path.exists(f"/proc/{pid}")
    assert (gate.pid, gate.life, gate.state) == (0, None, "waiting")
    assert gate.restart.ns == scene.now_ns + TRY_AGAIN_NS
    scene.supervisor._events.flush()
    (event,) = scene.events()
    reason = "[Errno 24] Too many open files"
    assert (event["kind"], event["fields"]) == ("start_failed", {"process": "gate", "reason": reason})
    assert event["text"] == f"cannot start gate: {reason}; trying again"


def test_nor_one_whose_news_the_loop_does_not_take(scene: Scene) -> None:
    found: list[Lifeline] = []

    def unwatchable(pid: int) -> Lifeline:
        found.append(Lifeline(pid))
        os.close(found[0].fd)
        found[0].fd = os.open(__file__, os.O_RDONLY)  # a file: epoll takes none
        return found[0]

    scene.world.play("spawn", lambda *_: os.posix_spawnp("sleep", ["sleep", "120"], os.environ))
    scene.world.play("lifeline", unwatchable)
    gate = scene.supervisor.processes[layout.GATE]
    scene.supervisor.processes.start(gate)
    assert not os.path.exists(f"/proc/{found[0].pid}")
    assert found[0].fd == -1, "it is closed"
    assert (gate.pid, gate.life, gate.state) == (0, None, "waiting")


def test_a_death_that_can_not_be_collected_yet_holds_nobody_up(scene: Scene) -> None:
    """As while a debugger holds the dead process; here it has not even died, and its pidfd is said to be ready."""
    processes = scene.supervisor.processes
    gate = processes[layout.GATE]
    pid = os.posix_spawnp("sleep", ["sleep", "120"], os.environ)
    gate.started(Lifeline(pid), 1, scene.now_ns)
    assert gate.life
    scene.supervisor.loop.watch(gate.life.fd, READ)
    gate.on(DIED)
    processes.reap({gate.life.fd: READ}, scene.now_ns)
    assert (gate.pid, gate.restart.ns) == (pid, NEVER)
    os.kill(pid, signal.SIGKILL)
    assert gate.life.wait(20.0)
    assert gate.life.fd not in scene.supervisor.loop.wait(0), "it would wake the supervisor without end"
    processes.reap({}, scene.now_ns)
    assert (gate.pid, gate.life, gate.last_exit, gate.state) == (0, None, "killed by SIGKILL", "waiting")
    scene.supervisor._events.flush()
    assert scene.events()[0]["text"] == f"gate (pid {pid}) was killed by SIGKILL"


@pytest.mark.parametrize(("number", "told"), [(signal.SIGTERM, "SIGTERM"), (signal.SIGRTMIN + 2, "36")])
def test_a_signal_is_told_by_its_name_where_it_has_one(scene: Scene, number: int, told: str) -> None:
    gate = scene.supervisor.processes[layout.GATE]
    gate.started(Lifeline(os.posix_spawnp("sleep", ["sleep", "120"], os.environ)), 1, scene.now_ns)
    os.kill(gate.pid, number)
    assert gate.life
    assert gate.life.wait(20.0)
    assert gate.reap() == gate.last_exit == f"killed by {told}"


def test_one_that_ends_by_itself_is_told_by_its_code_also_when_that_is_0(scene: Scene) -> None:
    gate = scene.supervisor.processes[layout.GATE]
    gate.started(Lifeline(os.posix_spawnp("true", ["true"], os.environ)), 1, scene.now_ns)
    assert gate.life
    assert gate.life.wait(20.0)
    assert gate.reap() == gate.last_exit == "exited with code 0"


def test_a_process_that_is_ended_is_collected(scene: Scene) -> None:
    gate = scene.supervisor.processes[layout.GATE]
    pid = os.posix_spawnp("sleep", ["sleep", "120"], os.environ)
    gate.started(Lifeline(pid), 1, scene.now_ns)
    gate.kill(20.0)
    assert (gate.pid, gate.life) == (0, None)
    assert not os.path.exists(f"/proc/{pid}")
    gate.kill(20.0)


def test_no_process_is_given_the_futexes_of_one_that_lives_or_of_the_one_before(scene: Scene) -> None:
    processes = scene.supervisor.processes
    processes[layout.PORT_OWNER].block = 3
    found = [processes._free_block() for _ in range(BLOCKS)]
    assert found == [*(block for block in range(BLOCKS) if block not in (layout.SUPERVISOR_BLOCK, 3)), 1, 2]


def test_what_a_process_is_told_on_its_command_line(scene: Scene) -> None:
    told: list[tuple[list[str], Sequence[int]]] = []

    def spawn(arguments: list[str], environ: Mapping[str, str], passed: Sequence[int] = ()) -> int:
        told.append((arguments, passed))
        assert environ == starter.environment(Settings())
        raise OSError("no further")

    scene.world.play("spawn", spawn)
    scene.port.number = 5
    scene.port.fd, fd = -1, scene.port.fd
    for child in scene.supervisor.children:
        child.state, child.pid = WAITING, 0
        scene.supervisor.processes.start(child)
        row, (arguments, passed) = child.row, told.pop()
        assert arguments[:3] == [sys.executable, "-I", "-S"]
        assert arguments[3].endswith("/supervisor/child.py")
        assert os.path.exists(arguments[3])
        assert arguments[4] == row.name
        run, block = scene.run, scene.supervisor.processes._block
        words = [f"name={run.name}", f"run={run.incarnation:x}", f"dir={run.runtime_dir}", f"parent={os.getpid()}"]
        numbers = run.descriptors(row.name, -1)
        given = [f"{key}={numbers[key]}" for key in row.descriptors]
        assert arguments[5:] == [*words, f"block={block}", "number=5", *given]
        assert list(passed) == [numbers[key] for key in row.descriptors if key != "port"]
    scene.port.fd = fd


def test_a_process_that_starts_is_named_to_those_who_watch_it(scene: Scene) -> None:
    processes, gate = scene.supervisor.processes, scene.supervisor.processes[layout.GATE]
    scene.world.play("spawn", lambda *_: os.posix_spawnp("sleep", ["sleep", "120"], os.environ))
    processes.start(gate)
    assert (gate.block, gate.state, gate.restart.ns) == (1, "starting", NEVER)
    assert gate.started_ns == scene.now_ns
    assert scene.word("gate_life").get() == records.life(gate.pid, 1)
    for process in (layout.PORT_OWNER, layout.STOPPER):
        assert select.select([scene.run.bells[process].fd], [], [], 0)[0]
    os.kill(gate.pid, signal.SIGKILL)
    assert gate.life
    assert gate.life.wait(20.0)
    assert gate.life.fd in scene.supervisor.loop.wait(0), "its death wakes the supervisor"
    gate.kill(0.0)


def test_what_is_told_of_deaths_and_restarts_until_it_is_down(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    processes, telemetry = scene.supervisor.processes, scene.supervisor.processes[layout.TELEMETRY]
    told: list[tuple[str, str, dict[str, object]]] = []
    for _ in range(5):
        pid = os.posix_spawnp("false", ["false"], os.environ)
        telemetry.started(Lifeline(pid), 1, scene.now_ns)
        assert telemetry.life
        assert telemetry.life.wait(20.0)
        telemetry.on(DIED)
        scene.supervisor.loop.watch(telemetry.life.fd, READ)
        processes.reap({}, scene.now_ns)
        scene.supervisor._events.flush()
        died, then = ((event["kind"], event["text"], event["fields"]) for event in scene.events())
        how = {"process": "telemetry", "pid": pid, "how": "exited with code 1"}
        assert died == ("died", f"telemetry (pid {pid}) exited with code 1", how)
        told.append(then)
    waits = ((0.0, "now"), (0.1, "in 0.1 s"), (0.2, "in 0.2 s"), (0.4, "in 0.4 s"))
    restarts = [
        ("restarting", f"restarting telemetry {when}", {"process": "telemetry", "wait_s": wait_s})
        for wait_s, when in waits
    ]
    todo = f"next: see to the cause, then `failstop reset --name {scene.run.name}` restarts it"
    text = f"telemetry died too often and is down, the wheels stopped; {todo}"
    assert told == [*restarts, ("down", text, {"process": "telemetry"})]
    assert (telemetry.state, telemetry.restart.ns) == ("down", NEVER)
    processes.recall(scene.now_ns)
    assert (telemetry.state, telemetry.restart.ns) == ("waiting", scene.now_ns)


Stopping = Callable[[], None] | None


class Asked:
    """Early news: who asks for which."""

    def __init__(self, bell: EventBell) -> None:
        self.bell = bell
        self.of: list[tuple[int, int, int, int]] = []
        """Whose death, at which futex (block, watcher), and the priority of who dies."""
        self.stops: list[Stopping] = []
        """What is done at once when it comes."""

    def arm(self, life: Lifeline, block: int, watcher: int, stop: Stopping = None, dying: int = 0) -> None:
        life.armed = True
        self.of.append((life.pid, block, watcher, dying))
        self.stops.append(stop)


def test_the_early_news_of_each_process_that_runs_is_waited_for_once_and_that_of_the_port_owner_stops(
    scene: Scene,
) -> None:
    processes = scene.supervisor.processes
    port_owner, gate, stopper = (processes[name] for name in (layout.PORT_OWNER, layout.GATE, layout.STOPPER))
    asked = Asked(processes.early.bell)
    processes.early = asked  # type: ignore[assignment]
    port_owner.state = WAITING
    for child, block in ((port_owner, 4), (gate, 5), (stopper, 6)):
        child.started(Lifeline(os.posix_spawnp("sleep", ["sleep", "120"], os.environ)), block, scene.now_ns)
    for child, own in ((port_owner, scene.port_owner), (gate, scene.gate)):
        own.word("beat_pid").set(child.pid)
        own.word("beat_state").set(RUNNING)
    processes.arm()
    processes.arm()
    assert asked.of == [
        (port_owner.pid, 4, 0, port_owner.row.priority),
        (gate.pid, 5, 0, gate.row.priority),
    ], "one that starts holds nothing yet"
    stop, none = asked.stops
    assert none is None, "for others the port owner stops"
    assert stop is not None, "the port owner's death is stopped for by the thread that learns of it"
    stop()
    assert os.read(scene.master, 65536) == BOARD.first_stop
    for child in (port_owner, gate, stopper):
        child.kill(20.0)


def test_every_restart_is_counted(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    processes, gate = scene.supervisor.processes, scene.supervisor.processes[layout.GATE]
    monkeypatch.setattr(type(processes), "start", lambda _processes, child: child.restart.set(NEVER))
    for _ in range(3):
        gate.restart.set(scene.now_ns)
        processes.restart_due(scene.now_ns)
    assert gate.times_restarted == 3

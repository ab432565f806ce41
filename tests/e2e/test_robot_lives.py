"""A Robot through the life of services and of its own: restarts, deaths, other versions, its close, a fork."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections.abc import Callable

import pytest

from failstop import FailstopError, NoService, Robot, State, instances
from failstop.api.client import attach
from failstop.api.client import run as run_of
from failstop.api.state import StateReader
from failstop.lab.trial import Trial, wait_for
from failstop.shm import cell, instance, layout, segment
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import Lifeline

CALLS: dict[str, Callable[[Robot], object]] = {
    "drive": lambda robot: robot.drive(0.1, 0.0, 0.0, manual=True),
    "sensed": lambda robot: robot.sensed(),
    "hold": lambda robot: robot.hold(),
    "enable": lambda robot: robot.enable(),
    "disable": lambda robot: robot.disable(),
    "reset": lambda robot: robot.reset(),
    "state": lambda robot: robot.state,
}
ENDED_S = 5.0


def stopped(state: State, *reasons: str) -> None:
    """Nothing in it says that anything moves, or may; the reason begins as one of these."""
    assert (state.estop or "").startswith(reasons)
    assert (state.enabled, state.blocked) == (False, f"estop: {state.estop}")
    assert not any((*state.body_vel, *state.wheels_radps))
    assert state.sources == ()
    assert not any(client.driving for client in state.clients)


def nobody_runs(name: str) -> None:
    """The last process of a service whose supervisor has died ends by itself, a moment later."""
    paths = instance.places(name)
    wait_for("the last process to end", lambda: not any(map(instances.running, paths)), ENDED_S)


# Another version.


def other_layout(memory: str, which: str) -> None:
    """Change the head of a segment to that of another version."""
    with open(segment.path_of(memory, which), "r+b", buffering=0) as file:
        entry = cell.check(file.read(layout.HEADER_BYTES), segment._HEADER_SEED)
        assert entry
        magic, _, *rest = segment._HEADER.unpack(entry[2])
        head = segment._HEADER.pack(magic, 4711, *rest)
        file.seek(0)
        file.write(cell.build(1, 0, head, segment._HEADER_SEED, layout.HEADER_BYTES - cell.HEADER_BYTES))


def test_a_service_of_another_version_can_be_stopped_and_only_that(trial: Trial) -> None:
    latch = attach(trial.name, layout.SUPERVISOR).word("epoch")
    epoch = latch.get()
    memory, _ = run_of(trial.name)
    for which in layout.PROCESSES:
        other_layout(memory, which)
    with Robot(trial.name) as robot:
        for call in CALLS.values():
            with pytest.raises(FailstopError, match="with another layout: use the service's own version"):
                call(robot)
        trial.board.events()
        robot.estop("a hand")
        wait_for("the epoch", lambda: latch.get() > epoch)
    assert trial.board.wait_for(lambda event: event.is_motor, 2.0).is_stop
    assert "a hand (" in trial.service.said()


def test_without_its_shared_memory_a_service_can_be_stopped(trial: Trial) -> None:
    path = segment.path_of(run_of(trial.name)[0], layout.SUPERVISOR)
    os.rename(path, path + "-away")
    robot = Robot(trial.name)
    trial.board.events()
    robot.estop("a hand")
    assert trial.board.wait_for(lambda event: event.is_motor, 2.0).is_stop
    os.rename(path + "-away", path)


# Restarts.


def new_run_is_met(trial: Trial, robot: Robot) -> None:
    """Every call means the run that is there now; motion is disabled in it until somebody enables."""
    robot.sensed()
    wait_for("the sensor's word", lambda: (age_s := robot.state.scan_age_s) is not None and age_s < 5.0)
    robot.drive(0.1, 0.0, 0.0, manual=True)
    state = robot.state
    assert (state.enabled, state.estop, state.blocked) == (False, None, "disabled")
    assert [client.name for client in state.clients] == [robot.client_name]
    assert not trial.moving()
    assert robot.enable() == "motion enabled"
    robot.drive(0.1, 0.0, 0.0, manual=True)
    trial.board.wait_wheels(moving=True, timeout_s=2.0)


@pytest.mark.parametrize("end", ["ends", "is killed"])
def test_a_restart_is_noticed_by_the_next_call(trial: Trial, end: str) -> None:
    with Robot(trial.name, client="lidar") as robot:
        trial.enable()
        robot.sensed()
        trial.leave()
        if end == "ends":
            trial.service.end()
        else:
            trial.service.kill()
        trial.service.start()
        new_run_is_met(trial, robot)


@pytest.mark.parametrize("call", CALLS)
def test_without_a_service_every_call_says_so_and_the_next_one_is_met(trial: Trial, call: str) -> None:
    with Robot(trial.name) as robot:
        robot.sensed()
        trial.service.end()
        for _ in range(2):
            with pytest.raises(NoService, match="start it with `failstop run"):
                CALLS[call](robot)
        trial.service.start()
        CALLS[call](robot)


@pytest.mark.parametrize("call", [call for call in CALLS if call != "state"])
def test_after_the_supervisor_s_death_no_call_is_silent(trial: Trial, call: str) -> None:
    with Robot(trial.name) as robot:
        robot.sensed()
        trial.service.kill()
        with pytest.raises(NoService):
            CALLS[call](robot)


def test_a_request_that_waits_when_the_service_dies_is_told_at_once(trial: Trial) -> None:
    """Long before the gate would have to have answered."""
    with Robot(trial.name) as robot:
        robot.sensed()
        os.kill(trial.service.pids()["gate"], signal.SIGSTOP)
        supervisor = trial.service.process
        assert supervisor
        killer = threading.Timer(0.02, supervisor.kill)
        killer.start()
        asked_s = time.monotonic()
        with pytest.raises(NoService):
            robot.enable()
        assert time.monotonic() - asked_s < 0.9
        killer.join()


# Closed.


@pytest.mark.parametrize("call", CALLS)
def test_closed_is_closed(trial: Trial, call: str) -> None:
    trial.enable()
    robot = Robot(trial.name)
    robot.sensed()
    robot.close()
    robot.close()
    with pytest.raises(FailstopError, match="is closed: make a new one"):
        CALLS[call](robot)
    with pytest.raises(FailstopError, match="is closed"):
        robot.__enter__()
    robot.estop("nothing keeps anybody from a stop")
    wait_for("the latch", lambda: trial.robot.state.estop is not None)


def test_no_command_of_a_thread_that_goes_on_reaches_the_wheels(trial: Trial) -> None:
    """It is in the middle of a call, as likely as not, when another one closes."""
    trial.enable()
    for _ in range(10):
        robot = Robot(trial.name, client="threads")
        ended = threading.Event()

        def go_on(robot: Robot = robot, ended: threading.Event = ended) -> None:
            try:
                while True:
                    robot.drive(0.1, 0.0, 0.0, manual=True)
            except FailstopError:
                ended.set()

        thread = threading.Thread(target=go_on)
        thread.start()
        trial.board.wait_wheels(moving=True, timeout_s=2.0)
        index = next(one.slot for one in trial.robot.state.clients if one.name == "threads")
        robot.close()
        path = segment.path_of(run_of(trial.name)[0], f"client.{index}")
        spec = layout.BY_NAME[f"client.{index}"]
        with open(path, "rb") as file:
            data = file.read()
        at = spec.offsets["command"]
        assert not any(data[at : at + spec.records["command"].size()])
        assert ended.wait(5.0)
        thread.join()
        trial.board.wait_wheels(moving=False, timeout_s=2.0)
        trial.board.events()
    assert trial.robot.state.estop is None
    assert not trial.moving()


def test_a_closed_slot_s_descriptor_is_no_other_file_s(trial: Trial) -> None:
    """Whatever still has a writer of the slot must not reach the file that gets its number next."""
    robot = Robot(trial.name)
    commands = robot._client()._records["command"]
    robot.close()
    with open(os.devnull, "wb"), pytest.raises(OSError, match="Bad file descriptor"):
        commands.write(b"x")


def test_a_signal_s_handler_may_close_what_it_has_interrupted(trial: Trial) -> None:
    robot = Robot(trial.name)
    before = signal.signal(signal.SIGALRM, lambda *_: robot.close())

    def drive_on() -> None:
        while True:
            robot.drive(0.0, 0.0, 0.0)

    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises((FailstopError, OSError)):
            drive_on()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    wait_for("the slot to be free", lambda: trial.robot.state.clients == ())


def test_a_robot_that_nobody_refers_to_gives_its_slot_back(trial: Trial) -> None:
    trial.enable()
    robot = Robot(trial.name, client="dropped")
    robot.drive(0.1, 0.0, 0.0, manual=True)
    trial.board.wait_wheels(moving=True, timeout_s=2.0)
    dropped_ns = time.monotonic_ns()
    del robot
    gc.collect()
    zero = trial.board.wait_for(
        lambda event: event.is_motor and not any(event.speeds) and event.arrival_ns > dropped_ns, 2.0
    )
    assert zero.arrival_ns - dropped_ns < 250e6, "before the command timeout"
    wait_for("its slot to be free", lambda: [one.name for one in trial.robot.state.clients] == ["trial"])


def child(action: Callable[[], None]) -> int:
    """Fork; returns the child's exit code, 0 when `action` raised nothing."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            action()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fork_leaves_the_parent_s_slot_alone_and_takes_one_of_its_own(trial: Trial) -> None:
    robot = Robot(trial.name, client="parent")
    robot.sensed()
    wait_for("the client", lambda: len(robot.state.clients) == 1)

    def drops_it() -> None:
        nonlocal robot
        del robot
        gc.collect()

    def closes_it() -> None:
        robot.close()

    def uses_it() -> None:
        robot.sensed()
        wait_for("both", lambda: len({client.slot for client in robot.state.clients}) == 2)

    held = threading.Event()
    let_go = threading.Event()

    def hold_the_lock() -> None:
        with robot._lock:
            held.set()
            let_go.wait(10.0)

    holder = threading.Thread(target=hold_the_lock)
    holder.start()
    assert held.wait(5.0)
    assert child(uses_it) == 0, "though another thread held the lock when it was forked"
    let_go.set()
    holder.join()
    keeps = robot
    assert child(closes_it) == 0
    assert child(drops_it) == 0
    wait_for("the parent alone", lambda: [one.pid for one in trial.robot.state.clients] == [os.getpid()])
    assert keeps._client().slot == trial.robot.state.clients[0].slot
    robot.close()


# The end of the supervisor, as the state tells it.


def test_the_state_tells_of_the_supervisor_s_death_at_once(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.3)
    robot = trial.robot
    assert robot.state.enabled
    assert any(robot.state.wheels_radps)
    life = Lifeline(trial.service.pids()["supervisor"])
    life.kill()
    assert life.wait(5.0)
    found = robot.state, StateReader(trial.name).read()
    life.close()
    for state in found:
        stopped(state, "supervisor died", "supervisor hangs: ")
        assert {name: row.state for name, row in state.processes.items()} == {
            "supervisor": "dead",
            "gate": "dead",
            "telemetry": "dead",
            "port_owner": "stopping",
            "stopper": "stopping",
        }
    nobody_runs(trial.name)
    with pytest.raises(NoService):
        _ = robot.state


def test_the_death_of_all_at_once_is_told_by_nobody_and_seen(trial: Trial) -> None:
    """Nobody can say anything of it: the lock on the supervisor's memory tells, in whatever container."""
    reader = StateReader(trial.name)
    pids = trial.service.pids()
    trial.enable()
    trial.drive(0.3)
    assert reader.read().enabled
    for pid in pids.values():
        os.kill(pid, signal.SIGSTOP)
    for pid in pids.values():
        os.kill(pid, signal.SIGKILL)
    wait_for("the end of the run", reader.over, ENDED_S)
    stopped(reader.read(), "supervisor died")


def test_a_stop_that_nobody_answers_is_told_once_the_supervisor_s_lease_has_run_out(trial: Trial) -> None:
    """Supervisor and gate hang: the one can raise no epoch, and the record of the other says that it drives."""
    pids = trial.service.pids()
    trial.enable()
    trial.drive(0.3)
    stops = attach(trial.name, layout.PORT_OWNER).ring_reader("stops", from_oldest=True)
    try:
        for process in ("gate", "supervisor"):
            os.kill(pids[process], signal.SIGSTOP)
        wait_for("the port owner's word", lambda: stops.next() is not None)
        wait_for("the lease to run out", lambda: trial.robot.state.cause is not None, 0.1)
        stopped(trial.robot.state, "the supervisor is silent")
    finally:
        for process in ("supervisor", "gate"):
            os.kill(pids[process], signal.SIGCONT)


def test_a_supervisor_that_only_hangs_is_no_end_of_its_run(trial: Trial) -> None:
    """The slot is kept."""
    with Robot(trial.name) as robot:
        slot_before = robot._client().slot
        pid = trial.service.pids()["supervisor"]
        beat = HeartbeatReader(attach(trial.name, layout.SUPERVISOR))
        os.kill(pid, signal.SIGSTOP)
        try:
            wait_for("the lease to run out", lambda: beat.age_ns(time.monotonic_ns()) > 61_000_000)
            client = robot._client()
            robot.sensed()
            assert robot._client() is client
            assert client.slot == slot_before
        finally:
            os.kill(pid, signal.SIGCONT)

"""A Robot through the life of services and of its own: restarts, deaths, other versions, its close, a fork."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from failstop import FailstopError, Robot
from failstop.api.client import run as run_of
from failstop.api.state import StateReader
from failstop.messages import layout, segments
from failstop.shm import cell
from failstop.shm.segment import HEADER_BYTES
from failstop_lab.trial import Trial, wait_for
from tests.support import children
from tests.support.simulated import MS, Simulated

CALLS: dict[str, Callable[[Any], object]] = {
    "drive": lambda robot: robot.drive(0.1, 0.0, 0.0, manual=True),
    "sensed": lambda robot: robot.sensed(),
    "assert_interlocks": lambda robot: robot.assert_interlocks(),
    "enable": lambda robot: robot.enable(),
    "disable": lambda robot: robot.disable(),
    "reset": lambda robot: robot.reset(),
    "state": lambda robot: robot.state,
}
ENDED_S = 5.0
SEED = cell.seed("header", 0)


def stopped(state: Any, *reasons: str) -> None:
    """Check that nothing in a state says that anything moves, or may; the reason begins as one of these."""
    assert (state.estop or "").startswith(reasons)
    assert (state.enabled, state.blocked) == (False, f"estop: {state.estop}")
    assert not any((*state.body_vel, *state.wheels_radps))
    assert state.sources == ()
    assert not any(client.driving for client in state.clients)


# Another version.


def other_layout(simulated: Simulated, which: str) -> None:
    """Change the head of a segment to that of another version."""
    memory, _ = simulated.load("failstop.api.client").run(simulated.name)
    fd = simulated.os.open(segments.path_of(memory, which), os.O_RDWR)
    entry = cell.check(simulated.os.pread(fd, HEADER_BYTES, 0), SEED)
    assert entry
    head = bytearray(entry[2])
    head[8] ^= 0xFF
    data = cell.build(1, 0, bytes(head), SEED, HEADER_BYTES - cell.CELL_HEADER_BYTES)
    simulated.os.pwrite(fd, data, 0)


def test_a_service_of_another_version_can_be_stopped_and_only_that(simulated: Simulated) -> None:
    latch = simulated.load("failstop.api.client").attach(simulated.name, layout.SUPERVISOR).word("epoch")
    epoch = latch.get()
    for which in layout.PROCESS_NAMES:
        other_layout(simulated, which)
    code, _, err = simulated.command("status")
    assert (code, err.count("\n"), "another layout" in err) == (1, 1, True)
    with simulated.failstop.Robot() as robot:
        for call in CALLS.values():
            with pytest.raises(simulated.failstop.FailstopError, match="another layout: use the service's own version"):
                call(robot)
        simulated.board.events()
        robot.estop("a hand")
        assert simulated.board.wait_for(lambda event: event.is_motor).is_stop
    assert latch.get() > epoch
    assert "a hand (" in simulated.said
    for words in (("estop", "even", "so"), ("stop", "--services")):
        code, out, err = simulated.command(*words)
        assert (code, "with another layout" in err, "look at the wheels" in err) == (1, True, True)
        assert out.startswith("the service 'failstop' has taken the request, but this user can't see whether the stop")


def test_nobody_who_cannot_read_the_state_says_that_a_stop_was_written(simulated: Simulated) -> None:
    """The service takes the request while the cable is out, but no byte leaves."""
    simulated.board.unplug()
    simulated.wait_for("the loss", lambda: simulated.robot.state.device.state != "open")
    for which in layout.PROCESS_NAMES:
        other_layout(simulated, which)
    code, out, err = simulated.command("stop")
    assert (code, out.count("written"), "can't see whether the stop was written" in out) == (1, 1, True)
    assert "use the POWER SWITCH" in err


def test_without_its_shared_memory_a_service_can_be_stopped(simulated: Simulated) -> None:
    path = segments.path_of(simulated.load("failstop.api.client").run(simulated.name)[0], layout.SUPERVISOR)
    simulated.os.rename(path, path + "-away")
    robot = simulated.failstop.Robot()
    simulated.board.events()
    robot.estop("a hand")
    assert simulated.board.wait_for(lambda event: event.is_motor).is_stop
    simulated.os.rename(path + "-away", path)


# Restarts.


@pytest.mark.parametrize("end", ["ends", "is killed"])
def test_a_restart_is_noticed_by_the_next_call(simulated: Simulated, end: str) -> None:
    """Every call means the run that is there now; motion is disabled in it until somebody enables."""
    with simulated.failstop.Robot(client="lidar") as robot:
        simulated.enable()
        robot.sensed()
        simulated.leave()
        if end == "ends":
            assert simulated.end() == 0
        else:
            simulated.die(layout.SUPERVISOR)
            simulated.wait_for("the last process to end", lambda: not simulated.living())
        simulated.start()
        robot.sensed()
        simulated.wait(0.2)
        assert robot.state.scan_age_s < 0.3
        robot.drive(0.1, 0.0, 0.0, manual=True)
        state = robot.state
        assert (state.enabled, state.estop, state.blocked) == (False, None, "disabled")
        assert [client.name for client in state.clients] == [robot.client_name]
        assert not simulated.turning()
        assert (
            robot.enable() == "motion enabled; lidar (pid 100) must send zero or pause before it can drive "
            "(or end it, enable motion, and start it again)"
        )
        robot.drive(0.0, 0.0, 0.0, manual=True)
        simulated.wait(0.05)
        robot.drive(0.1, 0.0, 0.0, manual=True)
        simulated.board.wait_wheels(turning=True)


@pytest.mark.parametrize("client", ["known to the gate before", "that comes meanwhile"])
def test_a_reset_while_no_gate_runs_is_answered_by_the_next_one(simulated: Simulated, client: str) -> None:
    with simulated.failstop.Robot(client="lidar") as robot:
        if client == "known to the gate before":
            robot.sensed()
        simulated.die(layout.GATE)
        robot.wait_for("latched", 1.0)
        assert robot.state.processes[layout.GATE].state != "running"
        robot.reset()
        state = robot.state
        assert (state.cause, state.enabled) == (None, False)


@pytest.fixture
def robots(simulated: Simulated) -> Iterator[dict[str, Any]]:
    """A Robot that has been used, for each of the calls."""
    made = {call: simulated.failstop.Robot() for call in CALLS}
    for robot in made.values():
        robot.sensed()
    yield made
    for robot in made.values():
        robot.close()


def test_without_a_service_every_call_says_so_and_the_next_one_is_met(
    simulated: Simulated, robots: dict[str, Any]
) -> None:
    simulated.leave()
    simulated.end()
    for call, robot in robots.items():
        for _ in range(2):
            with pytest.raises(simulated.failstop.NoService, match="start it with `failstop run"):
                CALLS[call](robot)
    simulated.start()
    for call, robot in robots.items():
        CALLS[call](robot)


def test_after_the_supervisor_s_death_no_call_is_silent(simulated: Simulated, robots: dict[str, Any]) -> None:
    simulated.die(layout.SUPERVISOR)
    simulated.wait(0.001)
    for call in CALLS.keys() - {"state"}:
        with pytest.raises(simulated.failstop.NoService):
            CALLS[call](robots[call])


def test_a_request_that_waits_when_the_service_dies_is_told_at_once(simulated: Simulated) -> None:
    """Long before the gate would have to have answered."""
    with simulated.failstop.Robot() as robot:
        robot.sensed()
        simulated.suspend("gate")
        dies_ns = simulated.now_ns() + 20 * MS
        simulated.lab.machine.at(dies_ns, lambda: simulated.die(layout.SUPERVISOR))
        with pytest.raises(simulated.failstop.NoService):
            robot.enable()
        assert 0 <= simulated.now_ns() - dies_ns < 20 * MS


# Closed.


def test_closed_is_closed(simulated: Simulated) -> None:
    simulated.enable()
    robot = simulated.failstop.Robot()
    robot.sensed()
    robot.close()
    robot.close()
    for call in CALLS.values():
        with pytest.raises(simulated.failstop.FailstopError, match="is closed: make a new one"):
            call(robot)
    with pytest.raises(simulated.failstop.FailstopError, match="is closed"):
        robot.__enter__()
    robot.estop("nothing keeps anybody from a stop")
    simulated.robot.wait_for("latched", 1.0)


def test_no_command_of_a_thread_that_goes_on_reaches_the_wheels(trial: Trial) -> None:
    """The thread is in the middle of a call, as likely as not, when another one closes."""
    trial.enable()
    for _ in range(4):
        robot = Robot(trial.name, client="threads")

        def go_on(robot: Robot = robot) -> None:
            with contextlib.suppress(FailstopError):
                while True:
                    robot.drive(0.1, 0.0, 0.0, manual=True)

        thread = threading.Thread(target=go_on)
        thread.start()
        trial.board.wait_wheels(turning=True, timeout_s=5.0)
        index = next(one.slot for one in trial.robot.state.clients if one.name == "threads")
        robot.close()
        path = segments.path_of(run_of(trial.name)[0], f"client.{index}")
        spec = layout.SEGMENT_BY_NAME[f"client.{index}"]
        with open(path, "rb") as file:
            data = file.read()
        at = spec.offsets["command"]
        assert not any(data[at : at + spec.records["command"].size()])
        thread.join(5.0)
        assert not thread.is_alive()
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        trial.board.events()
    assert trial.robot.state.estop is None
    assert not trial.turning()


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


def test_a_robot_that_nobody_refers_to_gives_its_slot_back(simulated: Simulated) -> None:
    simulated.enable()
    robot = simulated.failstop.Robot(client="dropped")
    robot.drive(0.1, 0.0, 0.0, manual=True)
    simulated.board.wait_wheels(turning=True)
    dropped_ns = simulated.now_ns()
    del robot
    gc.collect()
    zero = simulated.board.wait_for(
        lambda event: event.is_motor and not any(event.speeds) and event.arrival_ns > dropped_ns
    )
    assert zero.arrival_ns - dropped_ns <= 21 * MS, "before the command timeout"
    simulated.wait(0.2)
    assert [one.name for one in simulated.robot.state.clients] == ["trial"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fork_leaves_the_parent_s_slot_alone_and_takes_one_of_its_own(trial: Trial) -> None:
    robot = Robot(trial.name, client="parent")
    robot.sensed()
    wait_for("the client", lambda: len(robot.state.clients) == 1)
    slot = robot.state.clients[0].slot

    def drops_it() -> None:
        nonlocal robot
        del robot
        gc.collect()

    def uses_it() -> None:
        robot.sensed()
        wait_for("both", lambda: len({client.slot for client in robot.state.clients}) == 2)

    done = threading.Event()

    def hold_the_lock() -> None:
        while not done.is_set():
            robot.sensed()

    holder = threading.Thread(target=hold_the_lock)
    holder.start()
    for _ in range(6):
        children.call(uses_it)  # though another thread may hold the lock when it is forked
    done.set()
    holder.join()
    keeps = robot
    children.call(robot.close)
    children.call(drops_it)
    wait_for("the parent alone", lambda: [one.pid for one in trial.robot.state.clients] == [os.getpid()])
    keeps.sensed()
    assert [one.slot for one in keeps.state.clients] == [slot]
    robot.close()


# The end of the supervisor, as the state tells it.


def test_the_death_of_all_at_once_is_told_by_nobody_and_seen(fresh: Trial) -> None:
    """Nobody can say anything of it: the lock on the supervisor's memory tells, in whatever container."""
    reader = StateReader(fresh.name)
    pids = fresh.service.pids()
    fresh.enable()
    fresh.drive(0.3)
    assert reader.read().enabled
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for pid in pids.values():
            os.kill(pid, number)
    wait_for("the end of the run", reader.over, ENDED_S)
    stopped(reader.read(), "supervisor died")


def test_a_stop_that_nobody_answers_is_told_once_the_supervisor_s_lease_has_run_out(simulated: Simulated) -> None:
    """Supervisor and gate hang: the one can raise no epoch, and the record of the other says that it drives."""
    simulated.set_off()
    for process in ("gate", layout.SUPERVISOR):
        simulated.suspend(process)
    hung_ns = simulated.now_ns()
    simulated.wait_for("the latch", lambda: simulated.robot.state.cause is not None)
    assert simulated.now_ns() - hung_ns <= 85 * MS
    stopped(simulated.robot.state, "the supervisor is silent")
    for process in (layout.SUPERVISOR, "gate"):
        simulated.resume(process)


def test_a_supervisor_that_only_hangs_is_no_end_of_its_run(simulated: Simulated) -> None:
    """The slot is kept."""
    with simulated.failstop.Robot(client="keeps") as robot:
        robot.sensed()
        simulated.wait(0.2)
        before = robot.state.clients
        simulated.hold(layout.SUPERVISOR, 0.1)
        simulated.wait(0.08)
        robot.sensed()
        simulated.wait(0.3)
        robot.sensed()
        assert [(one.name, one.slot) for one in robot.state.clients] == [(one.name, one.slot) for one in before]
        assert before[0].name == "keeps"

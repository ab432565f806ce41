"""The board comes back while a process is dead, hangs, or has no room for the port: the stop is written, and motion is
not ready before all three have the port."""

from __future__ import annotations

import os
import resource
import signal
import time

import pytest

from failstop.lab.trial import Trial, wait_for
from failstop.messages import layout
from tests.support.boards import every_board
from tests.support.simulated import MS, Simulated

from .returns import drives_only_when_enabled, lose_while_driving, stop_at_return


def lost(simulated: Simulated) -> None:
    """Drive, and pull the plug."""
    simulated.set_off()
    simulated.board.unplug()
    simulated.wait_for("the loss to be seen", lambda: simulated.robot.state.device.state == "lost")


def stopped_at_return(simulated: Simulated) -> None:
    """The first motor frame after the plug is in again is a stop, at once; then nothing moves before an enable."""
    simulated.board.events()
    back_ns = simulated.now_ns()
    simulated.board.replug()
    if simulated.lab.board.traits.resets:
        simulated.wait_for("the reset that opening its port is", lambda: not simulated.turning(), 0.02)
    else:
        event = simulated.board.wait_for(lambda event: event.is_motor)
        assert event.is_stop
        assert event.arrival_ns - back_ns <= 5 * MS + simulated.own_ns
    simulated.wait_for("a whole service", lambda: simulated.robot.state.waiting_for is None)
    simulated.drive(0.1)
    assert not simulated.turning()
    simulated.enable()
    simulated.drive(0.2)
    assert simulated.turning()


def test_while_the_port_owner_waits_for_its_restart() -> None:
    simulated = Simulated({"restart.backoff_s": 2.0})
    pid = simulated.pids()["port_owner"]
    simulated.die("port_owner")
    simulated.recover("port_owner", pid)  # the first is restarted at once
    lost(simulated)
    simulated.die("port_owner")
    simulated.wait_for("its death", lambda: simulated.robot.state.processes["port_owner"].state == "waiting")
    stopped_at_return(simulated)
    assert simulated.robot.state.last_stop.written_s is not None


@pytest.mark.claim("PORT-1")
@every_board
def test_while_the_port_owner_hangs(simulated: Simulated) -> None:
    """The port owner is not needed for the stop."""
    lost(simulated)
    pid = simulated.pids()["port_owner"]
    simulated.suspend("port_owner")
    simulated.wait(0.05)
    stopped_at_return(simulated)
    assert simulated.pids()["port_owner"] != pid


def test_while_nobody_hangs(simulated: Simulated) -> None:
    lost(simulated)
    stopped_at_return(simulated)
    # The duplicates of the new port are good for a stop too.
    assert simulated.kill("port_owner").motion_after == 0


class NoNumbers:
    """A process has no free descriptor number, for the length of a block."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        used = set(map(int, os.listdir(f"/proc/{pid}/fd")))
        self._lowest = next(number for number in range(len(used) + 1) if number not in used)
        self._before = resource.prlimit(pid, resource.RLIMIT_NOFILE)

    def __enter__(self) -> None:
        resource.prlimit(self._pid, resource.RLIMIT_NOFILE, (self._lowest, self._before[1]))

    def __exit__(self, *_: object) -> None:
        resource.prlimit(self._pid, resource.RLIMIT_NOFILE, self._before)


def test_while_there_is_no_room_for_the_port(fresh: Trial) -> None:
    for process in (layout.STOPPER, layout.PORT_OWNER, layout.SUPERVISOR):
        lose_while_driving(fresh)
        pids = fresh.service.pids()
        with NoNumbers(pids[process]):
            assert stop_at_return(fresh).is_stop, process
            if process == layout.SUPERVISOR:
                whole = "a service that is whole: it has kept a number for it"
                wait_for(whole, lambda: fresh.robot.state.waiting_for is None)
            else:
                since_s = time.monotonic()
                wait_for("some tries", lambda since_s=since_s: time.monotonic() - since_s > 0.3)  # type: ignore[misc]
                assert fresh.robot.state.waiting_for == "the port", "no motion without the second channel"
        drives_only_when_enabled(fresh)
        assert fresh.service.pids() == pids
    # The second channel: nobody else is left to stop.
    for hung in (layout.SUPERVISOR, layout.PORT_OWNER):
        os.kill(pids[hung], signal.SIGSTOP)
    hung_ns = time.monotonic_ns()
    wait_for(
        "the stopper's stop",
        lambda: fresh.drive(0.05) or any(e.is_stop and e.arrival_ns > hung_ns for e in fresh.board.events()),
    )
    fresh.drive(0.1)
    assert not fresh.turning()
    os.kill(pids[layout.SUPERVISOR], signal.SIGCONT)

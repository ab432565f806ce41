"""The board comes back while a process is dead or hangs: the stop is written, and motion is not ready before all three
have the port."""

from __future__ import annotations

import pytest

from tests.support.boards import every_board
from tests.support.simulated import MS, Simulated


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

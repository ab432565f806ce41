"""A board that restarts while the robot drives, as after a dip of its supply: it stops, and nothing drives it again
before somebody enables motion."""

from __future__ import annotations

import random

import pytest

from failstop.board.ugv.wire import WATCHDOG_NS
from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.layouts import BOARDS
from tests.support.amounts import amount
from tests.support.simulated import MS, Simulated

DEAF_S = (0.06, 0.1, 0.25, 0.6, 1.5)
NOTICED_S = 0.35
"""After the board hears again: its counters are asked for every 0.2 s at boards that report nothing by themselves."""
PAUSE_S = {"rrc": 0.6, "feetech": 0.7}
"""Boards whose restart may show by nothing but a pause of their reports that is longer than this."""
FAR_S = 4.0
"""So long it drives first: a fall of counters that are near zero says little."""


def restarted(simulated: Simulated, rng: random.Random, deaf_s: float) -> str:
    """Restart the board of a robot that drives and goes on commanding; returns the cause of the stop."""
    simulated.drive(rng.uniform(0.0, 0.2))
    assert simulated.turning()
    simulated.board.restart(deaf_s)
    simulated.drive(deaf_s + NOTICED_S)
    if not (cause := simulated.robot.state.cause):
        return ""
    assert not simulated.turning()
    simulated.board.events()
    simulated.drive(0.5)
    assert not any(event.is_motion for event in simulated.board.events())
    return str(cause.kind.name)


@pytest.mark.slow
@pytest.mark.claim("BOARD-1")
@pytest.mark.parametrize("kind", BOARDS)
@pytest.mark.parametrize("prints", [True, False], ids=["prints", "prints nothing"])
def test_a_board_that_restarts_while_it_drives_is_stopped_for_until_an_enable(kind: str, prints: bool) -> None:
    simulated, rng = Simulated(kind=kind, imu_hz=110.0), random.Random(f"{kind} {prints}")
    simulated.lab.board.model.prints = prints
    for deaf_s in DEAF_S * amount(1, 10):
        simulated.set_off()
        simulated.drive(FAR_S)
        found = restarted(simulated, rng, deaf_s)
        if deaf_s < PAUSE_S.get(kind, 0.0) and not found:
            continue  # by a pause alone, and a busy computer explains a short one
        assert found in ("restarted", "deaf", "board_silent"), (deaf_s, found)
        assert found == "restarted" or deaf_s > 0.5
        simulated.wait(1.0)


def test_the_ugv_has_its_own_watchdog_set_again_by_the_next_enable() -> None:
    """It restarts while nothing moves, and has its 3 s again; then everything freezes while it drives."""
    simulated = Simulated(kind="ugv")
    simulated.board.restart(0.06)
    simulated.wait(0.5)
    assert simulated.robot.state.cause is None, "nothing moved"
    assert "the board restarted: it printed its boot text" in simulated.said
    simulated.set_off()
    for name in layout.PROCESS_NAMES:
        simulated.hold(name, 5.0)
    simulated.lab.machine.run(lambda: False, WATCHDOG_NS + 100 * MS)
    assert not simulated.turning()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hoverboard", "ugv", "rrc"])
def test_an_adapter_that_stalls_while_it_drives_is_no_restart(kind: str) -> None:
    """The reports come afterwards, all at once. A hoverboard drops frames that come all at once. If it drops all of 0.8
    s, its own watchdog acts, and it counts as deaf."""
    simulated, rng = Simulated(kind=kind, imu_hz=110.0), random.Random(kind)
    simulated.set_off()
    simulated.drive(1.0)
    for _ in range(amount(8, 200)):
        assert simulated.lab.board.port
        simulated.lab.board.port.stall(rng.randrange(20 * MS, 300 * MS))
        simulated.drive(0.6)
        cause = simulated.robot.state.cause
        if cause is not None:
            assert (kind, cause.kind) == ("hoverboard", causes.DEAF)
            simulated.robot.wait_for("ready", 5.0)
            simulated.set_off()
            continue
        assert simulated.turning()

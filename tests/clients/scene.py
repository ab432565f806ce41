"""What the tests of the C client share: the numbers of failstop.h, and a client that drives."""

from __future__ import annotations

from failstop_lab.stopped import Stopped, judge
from failstop_lab.trial import Trial, wait_for
from tests.support.c_client import Driver

OK = 0
NO_SERVICE, NO_PERMISSION, OTHER_LAYOUT, NO_SLOT, NOT_CONNECTED = -1, -2, -3, -4, -5
REFUSED, NO_ANSWER, UNDECLARED, INVALID, FORKED, DAMAGED, SYSTEM = -6, -7, -8, -9, -10, -11, -12
DISABLED, HELD, NO_COMMAND = 2, 3, 4
DRIVING, PREEMPTED, BLOCKED = 1, 2, 3
LATE_NS = 250_000_000
"""Less than the 0.3 s after which a silent client's command would have stopped the wheels anyway."""


def set_off(trial: Trial, driver: Driver, velocity: float = 0.2) -> None:
    """Have it drive until the wheels turn, with motion enabled by somebody else."""
    wait_for("the zero to be heard", lambda: driver.do("drive 0 0 0") or driver.state()["answer_block"] == DISABLED)
    trial.robot.enable()
    wait_for("the wheels to turn", lambda: driver.do(f"for 0.05 {velocity}") or trial.turning())
    trial.board.events()


def seen(trial: Trial, fault_ns: int) -> Stopped:
    """What the board saw, while a successor commands motion, as a program does that is started again at once."""
    with Driver() as again:
        again.connect(trial.name)
        again.do("for 0.3 0.2")
    return judge(trial.board.events(), fault_ns, was_turning=True)


def stays(trial: Trial, who: str, pid: int) -> None:
    state = trial.robot.state
    assert not state.enabled
    assert not trial.turning()
    assert f"{who} (pid {pid}) died after it had driven" in " ".join(str(trial.robot.why()).split())

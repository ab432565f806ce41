"""Invariants of the core: what cannot be is made to be while the robot drives. It stops, and says what was found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from failstop.messages import layout
from failstop.policy import causes
from tests.support.simulated import Simulated

BACKWARD = (-0.1, 0.0, 0.0)
SEEN_S = 0.3
"""The gate repeats its frame every 0.2 s."""


def word(simulated: Simulated, segment: str, name: str) -> memoryview:
    """A word of shared memory, whoever may write it."""
    names: dict[str, Any] = simulated.lab.machine.root.folder("/dev/shm").names
    file = next(file for path, file in names.items() if path.endswith(f".{segment}"))
    at = layout.SEGMENT_BY_NAME[segment].offsets[name]
    return memoryview(file.mapped())[at : at + 8].cast("Q")


def let_the_epoch_go_back(simulated: Simulated) -> None:
    word(simulated, layout.SUPERVISOR, "epoch")[0] -= 1


def write_as_another_process(simulated: Simulated) -> None:
    word(simulated, layout.PORT_OWNER, "beat_pid")[0] += 1


def enable_in_spite_of_a_latch(simulated: Simulated) -> None:
    """A gate that does not follow the supervisor's latch."""
    core = simulated.load("failstop.procs.gate.core").GateCore
    core.follow = lambda gate, _latched, _epoch: gate.stand_still()
    simulated.robot.estop("hand near wheel")
    simulated.wait_for("the latch", lambda: simulated.robot.state.estop)
    simulated.board.events()
    simulated.wait_for("an enable to be granted", lambda: enabled(simulated))


def enabled(simulated: Simulated) -> bool:
    """Whether the gate grants an enable now."""
    try:
        simulated.robot.enable()
    except simulated.failstop.Refused:
        return False
    return True


def write_what_is_older_than_a_stop(simulated: Simulated) -> None:
    """An admission that takes every frame, and a port owner that finds one and a stop request at the same moment."""
    admission = simulated.load("failstop.procs.port_owner.admission").Admission
    admission.current = lambda *_: True
    simulated.hold(layout.PORT_OWNER, 0.03)
    simulated.robot.drive(*BACKWARD)
    simulated.wait(0.005)
    simulated.robot.estop("hand near wheel")


CASES: dict[str, tuple[Callable[[Simulated], None], causes.Kind, str]] = {
    "epoch": (let_the_epoch_go_back, causes.DEFECT, "supervisor: epoch 1 while 2 was in force"),
    "writer": (
        write_as_another_process,
        causes.DEFECT,
        "port_owner: motion while another process writes its memory",
    ),
    "latch": (enable_in_spite_of_a_latch, causes.REQUESTED, "gate: motion while a stop is latched"),
    "order": (write_what_is_older_than_a_stop, causes.REQUESTED, "gate: motion while a stop is newer"),
}
"""Each defect, the cause that is latched then (the first), and the words for it."""


@pytest.mark.slow
@pytest.mark.claim("MOVE-1", "MOVE-2", "CAUSE-1")
@pytest.mark.parametrize("name", CASES)
def test_what_cannot_be_stops_the_robot_and_is_told(name: str) -> None:
    make, kind, told = CASES[name]
    simulated = Simulated()
    simulated.robot.estop()
    simulated.wait_for("the latch", lambda: simulated.robot.state.estop)
    simulated.set_off()
    make(simulated)
    if name != "order":
        simulated.drive(SEEN_S)
    simulated.wait(SEEN_S)
    assert not simulated.turning()
    assert f"internal error: {told}" in simulated.said
    assert simulated.robot.state.cause.kind is kind
    if kind is not causes.DEFECT:
        assert not any(any(frame.speeds) for frame in simulated.board.events())


def test_an_epoch_that_went_back_is_over_with_the_next() -> None:
    """Nothing moves by the epochs that were seen before; a reset and an enable are one above them all."""
    simulated = Simulated()
    simulated.set_off()
    let_the_epoch_go_back(simulated)
    simulated.drive(SEEN_S)
    assert not simulated.turning()
    simulated.set_off()
    assert simulated.turning()

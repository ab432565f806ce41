"""The guard port on the simulated machine: a driver of the bare board, faults, and parts of the guard taken out."""

from __future__ import annotations

import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import HAS_DRIVERS, traits_of
from failstop_lab.machine.loading import Patches
from failstop_lab.sim.model import Frame
from failstop_lab.simulate.guard_driver import LATE_MS, Guarded
from failstop_lab.simulate.scenarios import SCENARIOS
from failstop_lab.simulate.seeds import Nursery
from failstop_lab.simulate.single_faults import Plan, explore
from failstop_lab.simulate.stage import NEEDS, Stage
from tests.support.amounts import amount

pytestmark = pytest.mark.slow
NAMES = [name for name, play in SCENARIOS.items() if HAS_DRIVERS in NEEDS[play]]
KINDS = [kind for kind in BOARDS if HAS_DRIVERS in traits_of(kind).parts]
MS = 1_000_000
TALK, GUARD_SERVICE = "failstop.guard.talk", "failstop.guard.service"
GUARD = "failstop.guard.guard"
DEATH_IS_AN_END: Patches = ((TALK, "return not self._let_go_by(motions)", "return False"),)
LEAVES_IN_ORDER: Patches = ((GUARD, "self._board.leave(in_order=not drove)", "self._board.leave(in_order=True)"),)
DOOR_UNSEEN: Patches = ((GUARD, "        if news.ended:\n            self._end()\n", ""),)
OUTLIVES: Patches = ((TALK, "self._written_ns + self.timeout_ns - self._source_ns", "self._written_ns + 10**10"),)


def moves(stage: Stage) -> list[int]:
    """When a frame that turns a wheel was carried out, from now on, ns."""
    found: list[int] = []
    on_frame = stage.robot.board.on_frame

    def heard(frame: Frame) -> None:
        if any(frame.speeds):
            found.append(frame.executed_ns)
        on_frame(frame)

    stage.robot.board.on_frame = heard
    return found


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_each_scenario_is_right_without_a_fault_and_its_driver_moves_the_wheels(name: str, kind: str) -> None:
    stage = Stage(SCENARIOS[name], kind=kind)
    moved = moves(stage)
    stage.play()
    assert moved
    assert stage.witness.violations == []
    stage.prove_alive()
    assert stage.witness.violations == []


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("kind", KINDS)
def test_a_driver_that_never_ceased_to_command_moves_nothing_after_a_reset_and_an_enable(kind: str) -> None:
    moved: list[int] = []
    granted: list[int] = []

    def play(stage: Stage) -> None:
        robot = stage.connect()
        stage.enable(robot)
        guarded = Guarded(stage, robot)
        guarded.moves()
        stage.stop(robot)
        guarded.watch(0.2)
        stage.reset(robot)
        stage.enable(robot)
        granted.append(stage.machine.now_ns)
        guarded.watch(0.5)
        stage.disable(robot)
        guarded.kill_driver()

    stage = Stage(play, kind=kind)
    moved = moves(stage)
    stage.play()
    assert granted
    assert moved
    assert [t_ns for t_ns in moved if t_ns > granted[0]] == []


@pytest.mark.parametrize(
    ("patches", "name"),
    [
        pytest.param(DEATH_IS_AN_END, "guard_driver_dies", id="a driver's death counts as its end"),
        pytest.param(LEAVES_IN_ORDER, "guard_driver_dies", id="the service is told of an end in order"),
        pytest.param(DOOR_UNSEEN, "guard_driver_dies", id="the guard does not look who has gone"),
        pytest.param(OUTLIVES, "guard_driver_hangs", id="a silent driver's motion is renewed without end"),
    ],
)
def test_a_part_of_the_guard_that_is_taken_out_is_missed(patches: Patches, name: str) -> None:
    stage = Stage(SCENARIOS[name], patches=patches, kind="arduino")
    stage.run()
    assert stage.witness.violations


def test_the_bar_is_the_driver_s_timeout_and_two_ticks() -> None:
    assert LATE_MS == 300 + 2 * 20


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("name", NAMES)
def test_no_single_fault_turns_a_wheel_behind_the_guard(name: str) -> None:
    """A few calls; `failstop simulate --board arduino --scenario 'guard_*'` has all."""
    shares = amount(40, 1)
    found = explore(Plan(name, share=(NAMES.index(name), shares), most=1, board="arduino"))
    assert [run.text() for run in found.wrong] == []
    assert found.runs > 2


@pytest.mark.parametrize("kind", KINDS)
def test_no_drawn_fault_turns_a_wheel_behind_the_guard(kind: str) -> None:
    nursery = Nursery(NAMES, board=kind, rounds=amount(3, 12))
    runs = [nursery.run(seed) for seed in range(amount(2, 300))]
    assert [run.text() for run in runs if run.violations] == []
    assert sum(sum(run.groups.values()) for run in runs) > len(runs)

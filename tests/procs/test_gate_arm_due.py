"""When the gate wakes for the arm: later than now whatever was asked of the arm, taken or refused, and seldom."""

from __future__ import annotations

from math import inf, nan
from random import Random

import pytest

from failstop.messages import records
from failstop.policy import causes
from tests.support.amounts import amount
from tests.support.arm_settings import ARM, SERVOS
from tests.support.gate_scene import Scene
from tests.support.stage import MS

FOLLOW, JOG = records.ARM_FOLLOW, records.ARM_JOG
VERBS = (records.ARM_DRIVE, records.ARM_TUCK, records.ARM_HOLD, records.ARM_RELEASE, records.ARM_READ)
ANGLES = (0.0, 0.01, 0.3, -0.3, 1.0, 3.0, 1e9, -1e300, inf, nan)
TIMES_S = (0.0, 0.001, 0.05, 0.5, 5.0, 599.0, 601.0, -1.0, nan)
GOALS = amount(400, 100_000)
MOST_TURNS = 300
"""In a second in which nobody asks for anything: ticks, the moves of six joints, questions and their answers."""


def rows(random: Random, servos: list[int]) -> list[tuple[float, list[float]]]:
    times = [random.choice(TIMES_S) for _ in range(random.choice((1, 1, 1, 2, 3)))]
    if random.random() < 0.7:
        times = sorted(times)
    return [(t_s, [random.choice(ANGLES[:6]) for _ in servos]) for t_s in times]


def ask(scene: Scene, random: Random) -> None:
    """Ask for something at random, as one of two clients, the gamepad, or whoever stops."""
    client = int(random.random() < 0.1)
    servos = random.sample(SERVOS, random.randint(1, len(SERVOS)))
    kind = random.random()
    if kind < 0.3:
        scene.go(random.choice((1.0, 0.2, 0.0, 7.0)), servos, rows(random, servos), client)
    elif kind < 0.75:
        scene.goal(random.choice((FOLLOW, JOG)), {servo: random.choice(ANGLES) for servo in servos}, client)
    elif kind < 0.9:
        scene.ask_for(random.choice(VERBS), client)
    elif kind < 0.93:
        scene.pad(random.randint(0, 6), random.choice((0.0, 1.0, -0.3)))
    elif kind < 0.96:
        scene.ask_for(random.choice((records.ENABLE, records.DISABLE)), client)
    else:
        scene.stop(causes.KEY(1))


@pytest.fixture(params=[{}, {"arm.collision": "off"}], ids=["minds what is in the way", "does not"])
def scene(request: pytest.FixtureRequest) -> Scene:
    made = Scene(ARM | request.param)
    made.run(0.4)
    return made


def turns_in_a_second(scene: Scene) -> int:
    """How often the gate wakes while nobody asks for anything."""
    began_ns, turns = scene.clock(), 0
    while scene.clock() - began_ns < 1000 * MS:
        scene.wake()
        assert scene.gate.loop.due_ns() > scene.clock()
        turns += 1
    return turns


@pytest.mark.timeout(3600)
def test_no_goal_leaves_a_timer_in_the_past(scene: Scene) -> None:
    random = Random(GOALS)
    taken = refused = 0
    for number in range(GOALS // 2):
        if scene.gate.core.latch and random.random() < 0.5:
            scene.stop(causes.KEY(1))  # the supervisor latches it too, so that a reset counts
            scene.ask_for(records.RESET)
        else:
            ask(scene, random)
        for _ in range(random.choice((1, 1, 2, 3, 5, 30))):
            scene.wake()
            assert scene.gate.loop.due_ns() > scene.clock(), number
        taken += scene.gate.arm is not None and bool(scene.gate.arm.core.followed)
        refused += bool(scene.state()["refused"])
        if not number % 50:
            assert turns_in_a_second(scene) < MOST_TURNS, number
    assert min(taken, refused) > GOALS / 50, "the goals are of both kinds"


def test_a_move_that_is_refused_as_too_fast_leaves_the_gate_asleep(scene: Scene) -> None:
    scene.execute({1: 0.3}, over_s=0.05)
    done, text = scene.finish()
    assert (done, text.startswith("joint base at 6.000 rad/s")) == (records.REFUSED, True)
    assert turns_in_a_second(scene) < 100

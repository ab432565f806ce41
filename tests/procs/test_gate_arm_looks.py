"""An arm whose servos tell where they are while they move: looks on the way, and those that lag."""

from __future__ import annotations

from itertools import pairwise

import pytest

from failstop.board import servos
from failstop.board.interface import ServoBus
from failstop.board.kinds import board_of
from failstop.board.servos import LONGEST_MOVE_MS, POSITION
from failstop.policy.settings import Settings
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.core import ArmCore
from failstop.procs.gate.arm.goals import Goal
from failstop.procs.gate.arm.reader import AGREE, LOOKS_APART_NS
from tests.support.arm_settings import ARM, SERVOS

from .arm_bench import ME, SERVO_ANSWER_NS
from .gate_bench import MS, T0


def feetech(arm: dict[str, object]) -> tuple[ArmCore, ServoBus]:
    """An arm whose servos tell where they are while they move, and go on to their last goal."""
    bus = board_of("feetech", 0.1, 0.0).arm
    assert bus
    core = ArmCore(Settings({**arm, "board.kind": "feetech"}), bus, T0)
    for joint in core.joints:
        joint.known = joint.loaded = True
        joint.position = 2048.0
    return core, bus


def test_joints_on_their_way_are_looked_at_where_the_board_can_tell() -> None:
    core, bus = feetech(ARM)
    first = core.joints[0]
    core.accept(Goal(goals.FOLLOW, ME, "client 11", T0, {first: first.rad(2100.0)}), "", T0)
    frames = []
    now = T0
    while now < T0 + 120 * MS:
        frame, hold = core.step(now)
        assert not hold
        frames.append((now, frame))
        core.answer(first.servo, POSITION, 2050, now)
        now = core.due_ns
    looks = [(t_ns, frame) for t_ns, frame in frames if frame and bus.command(frame) == POSITION]
    assert [frame for _, frame in looks[:3]] == [bus.look(each) for each in ([1, 2, 3], [4, 5, 10], [1, 2, 3])]
    assert all(after - before >= LOOKS_APART_NS for (before, _), (after, _) in pairwise(looks))
    assert len(looks) >= 6
    assert sum(frame == b"" for _, frame in frames) <= 1, "it wakes for a move or a look"
    assert core.step(now - 1) == (b"", False), "news may wake it when nothing is due"
    assert (first.measured, first.measured_ns, first.known) == (2050, frames[-1][0], True)
    assert first.position != 2050, "one reading moves no joint that is on its way"


def test_the_only_joint_of_an_arm_is_looked_at_on_its_way() -> None:
    core, bus = feetech({"joints.base.servo": 4})
    core.accept(Goal(goals.JOG, ME, "client 11", T0, {core.joints[0]: 0.1}), "", T0)
    frames, now = [], T0
    while now < T0 + 60 * MS:
        frames.append(core.step(now)[0])
        now = core.due_ns
    assert frames.count(bus.look([4])) == 4


def begins_with(core: ArmCore, bus: ServoBus, servo: int, position: int, now: int) -> list[bytes]:
    """The questions to a servo that stands at this position, and the frame after them."""
    found: list[bytes] = []
    while not found or found[-1] == bus.read(servo, POSITION):
        if frame := core.step(now)[0]:
            found.append(frame)
        if frame == bus.read(servo, POSITION):
            core.answer(servo, POSITION, position, now + SERVO_ANSWER_NS)
        now = max(core.due_ns, now + SERVO_ANSWER_NS)
    return found


def test_torque_is_switched_on_where_a_hand_has_moved_the_joint() -> None:
    core, bus = feetech({"joints.base.servo": 4})
    joint = core.joints[0]
    joint.loaded = False
    core.accept(Goal(goals.FOLLOW, ME, "client 11", T0, {joint: joint.rad(2100.0)}), "", T0)
    assert begins_with(core, bus, 4, 3000, T0) == [*[bus.read(4, POSITION)] * 2, bus.torque(4, True, 3000)]
    assert joint.position == 3000


def test_a_look_at_a_joint_without_torque_does_not_count_as_its_reading() -> None:
    core, bus = feetech({"joints.base.servo": 4, "joints.elbow.servo": 5})
    moving, limp = core.joints
    limp.loaded = False
    core.accept(Goal(goals.JOG, ME, "client 11", T0, {moving: 0.0}), "", T0)
    core.step(T0)
    now = core.due_ns
    core.answer(limp.servo, POSITION, 3000, now)
    core.accept(Goal(goals.JOG, ME, "client 11", now, {limp: 0.0}), "", now)
    assert core.step(now) == (b"", True)
    assert begins_with(core, bus, 5, 3000, core.due_ns)[-1] == bus.torque(5, True, 3000)


TURNS = 400
"""Enough for an idle reader to ask each joint several times."""


def moves_after(core: ArmCore, bus: ServoBus, position: int, now: int) -> list[bytes]:
    """The moves that are sent from now on, while each servo says that it is at one position."""
    questions = {bus.read(servo, what): (servo, what) for servo in SERVOS for what in servos.READS}
    found = []
    for _ in range(TURNS):
        frame, _ = core.step(now)
        if question := questions.get(frame):
            core.answer(*question, position, now + SERVO_ANSWER_NS)
        elif frame:
            found.append(frame)
        now = max(core.due_ns, now + SERVO_ANSWER_NS)
    return found


def test_joints_that_lag_behind_the_goals_of_streams_are_sent_once_where_they_are() -> None:
    core, bus = feetech({**ARM, "arm.collision": "off"})
    now = T0
    for joint in core.joints[:3]:
        core.accept(Goal(goals.FOLLOW, ME, "client 11", now, {joint: joint.rad(2100.0)}), "", now)
        until_ns = now + 100 * MS
        while now < until_ns:
            core.step(now)
            now = core.due_ns
        core.drop("dropped")
    assert moves_after(core, bus, 2000, now) == [
        bus.move([(servo, 2000) for servo in group], LONGEST_MOVE_MS) for group in (SERVOS[:2], SERVOS[2:3])
    ]


@pytest.mark.parametrize(("off", "lags"), [(0, False), (AGREE, False), (-AGREE, False), (AGREE + 1, True)])
def test_joint_that_stands_at_its_last_goal_is_sent_nothing_more(off: int, lags: bool) -> None:
    core, bus = feetech({**ARM, "arm.collision": "off"})
    joint = core.joints[0]
    core.accept(Goal(goals.JOG, ME, "client 11", T0, {joint: 0.0}), "", T0)
    core.step(T0)
    core.drop("dropped")
    there = round(joint.position) + off
    assert moves_after(core, bus, there, core.due_ns) == (
        [bus.move([(joint.servo, there)], LONGEST_MOVE_MS)] if lags else []
    )

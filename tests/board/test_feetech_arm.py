"""The arm on Feetech's bus, beside the wheels: a policy's goals in, and what a stop leaves of them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from failstop.board import servos as questions
from failstop.board.checks import FrameError
from failstop.board.feetech import codec
from failstop.board.kinds import board_of
from failstop.policy import servos
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop_lab.boards.feetech import MIDDLE, POSITION_AT, Bus
from tests.support.simulated import MS, Simulated

NAMES = ("pan", "lift", "elbow", "flex", "roll", "gripper")
IDS = dict(zip(NAMES, range(1, 7), strict=True))
JOINTS = {f"joints.{name}.servo": servo for name, servo in IDS.items()} | {"arm.auto_tuck": "off"}
PER_RAD = 4096 / 6.283185
SPEED = 0.6
HOLDS_NS = 60 * MS
AHEAD = (0.1, 0.0, 0.0)


class Kiwi:
    """A LeKiwi on the simulated machine, and its policy."""

    def __init__(self) -> None:
        self.simulated = Simulated(JOINTS, kind="feetech")
        model: Any = self.simulated.lab.board.model
        self.bus: Bus = model.receiver
        self.angle = 0.0
        self.arm.follow(dict.fromkeys(NAMES, 0.0))
        self.simulated.wait_for("its torque", lambda: self.follow(0.0) and self.torques() == {1})

    @property
    def arm(self) -> Any:
        return self.simulated.robot.arm

    def torques(self) -> set[int]:
        return {self.bus.memory[servo][codec.TORQUE_SWITCH] for servo in IDS.values()}

    def at(self, address: int) -> list[int]:
        return [self.bus.word(servo, address) for servo in IDS.values()]

    def follow(self, rate: float = SPEED) -> bool:
        """A policy's goal for every joint, 30 times a second."""
        self.simulated.wait(0.033)
        self.angle += rate * 0.033
        self.arm.follow(dict.fromkeys(NAMES, self.angle))
        return True

    def drive(self, seconds: float) -> None:
        """Both at once."""
        for _ in range(round(seconds / 0.033)):
            self.follow()
            self.simulated.robot.sensed()
            self.simulated.robot.drive(0.1, 0.0, 0.0)


@pytest.fixture
def kiwi() -> Kiwi:
    return Kiwi()


def test_goals_are_a_whole_frame_for_the_arm_alone() -> None:
    board = board_of("feetech", 0.1, 0.0)
    arm = board.arm
    assert arm
    made = [
        arm.move([(1, 0), (6, 4095)], 40),
        arm.torque(2, True, 2048),
        arm.torque(2, False, 0),
        *(arm.read(3, what) for what in questions.READS),
        arm.look([1, 2, 3]),
    ]
    for frame in made:
        assert arm.check(frame, range(1, 7), 60) == ""
        assert arm.check(frame, (5,), 60)
        assert board.check_motion(frame, codec.LIMIT)
        for at in range(8 * len(frame)):
            garbled = bytearray(frame)
            garbled[at // 8] ^= 1 << at % 8
            assert arm.check(bytes(garbled), range(1, 254), 60)
        for end in range(len(frame)):
            assert arm.check(frame[:end], range(1, 7), 60) or frame[:end] == arm.move([(2, 2048)], 40)
    for frame in (*board.pings, board.stop, codec.TORQUE_ON, codec.packet(254, codec.WRITE, b"\x2e\0\0")):
        assert arm.check(frame, range(1, 254), 60)
    for wrong in ((7, 2048), (0, 5), (3, 4096), (3, -1)):
        with pytest.raises(FrameError):
            arm.move([wrong], 40)


def test_where_a_frame_sends_its_servos() -> None:
    board = board_of("feetech", 0.1, 0.0)
    arm = board.arm
    assert arm
    move = arm.move([(1, 500), (6, 4095)], 40)
    assert arm.moves(move) == [(1, 500, 0), (6, 4095, 0)]
    others = [arm.look([1, 2]), arm.torque(2, True, 2048), arm.torque(2, False, 0), board.stop, b"", move[:-1]]
    assert [arm.moves(other) for other in others] == [[]] * len(others)


@pytest.mark.parametrize(("key", "value", "told"), [("servo", 8, "the id of a wheel"), ("high", 5000, "1 to 4095")])
def test_a_joint_that_the_bus_has_not_is_refused(key: str, value: int, told: str) -> None:
    with pytest.raises(SettingError, match=told):
        Settings({"board.kind": "feetech", "joints.pan.servo": 1, f"joints.pan.{key}": value})
    with pytest.raises(SettingError, match="0 to 1000"):
        Settings({"joints.pan.servo": 1, "joints.pan.zero": 2048})


@pytest.mark.slow
@pytest.mark.parametrize("process", ["gate", "port_owner", "supervisor"])
def test_wheels_and_arm_move_at_once_and_stop_at_once(kiwi: Kiwi, process: str) -> None:
    """Goals of the servos are the judge: the wheels' zero, the joints' left where they are, torque on."""
    assert kiwi.at(codec.GOAL_POSITION) == kiwi.at(POSITION_AT) == [MIDDLE] * 6, "nothing jumps as it gets its torque"
    kiwi.simulated.enable()
    kiwi.drive(1.0)
    assert kiwi.bus.collisions == kiwi.bus.broadcast_speeds == 0
    assert any(kiwi.bus.wheels)
    assert kiwi.at(POSITION_AT) == pytest.approx([MIDDLE + kiwi.angle * PER_RAD] * 6, abs=0.15 * SPEED * PER_RAD)
    fault_ns = kiwi.simulated.now_ns()
    kiwi.simulated.board.events()
    kiwi.simulated.die(process)
    kiwi.simulated.wait(HOLDS_NS / 1e9)
    held = kiwi.at(POSITION_AT)
    kiwi.simulated.wait(0.3)
    assert kiwi.at(POSITION_AT) == held
    assert kiwi.torques() == {1}
    stops = [event.executed_ns for event in kiwi.simulated.board.events() if event.is_stop]
    assert stops[0] - fault_ns < 5 * MS
    assert not any(kiwi.bus.wheels)


def stale(kiwi: Kiwi) -> None:
    kiwi.follow()


def held(kiwi: Kiwi) -> None:
    kiwi.follow()
    kiwi.simulated.drive(0.3, AHEAD)
    kiwi.arm.hold()


def other_joints(kiwi: Kiwi) -> None:
    for name in ("pan", "lift"):
        kiwi.arm.jog({name: 0.3})
        kiwi.simulated.drive(0.3, AHEAD)


def gone(kiwi: Kiwi) -> None:
    def policy(failstop: Any) -> None:
        with failstop.Robot(client="policy") as robot:
            robot.arm.jog({"pan": 0.3})
            kiwi.simulated.time.sleep(0.3)

    kiwi.simulated.program("policy", policy)


@pytest.mark.parametrize("end", [stale, held, other_joints, gone])
def test_the_wheels_drive_on_when_the_arm_alone_ends(kiwi: Kiwi, end: Callable[[Kiwi], None]) -> None:
    """No zero for the wheels, from which they would start again without a ramp; and the arm stands."""
    kiwi.simulated.wait(1.0)
    kiwi.simulated.enable()
    kiwi.simulated.drive(1.0, AHEAD)
    assert any(kiwi.bus.wheels)
    kiwi.simulated.board.events()
    aimed = len(kiwi.bus.aimed)
    end(kiwi)
    kiwi.simulated.drive(1.5, AHEAD)
    assert len(kiwi.bus.aimed) > aimed, "the arm has moved"
    assert not kiwi.arm.state.mode
    assert [event for event in kiwi.simulated.board.events() if event.is_stop] == []
    at = kiwi.at(POSITION_AT)
    kiwi.simulated.drive(0.3, AHEAD)
    assert kiwi.at(POSITION_AT) == at
    assert kiwi.torques() == {1}


@pytest.mark.slow
def test_a_policy_is_streamed_in_time_and_every_joint_is_seen_meanwhile(kiwi: Kiwi) -> None:
    """All nine servos are read back while the wheels turn and the joints move; judged by when goals come to a servo."""
    kiwi.simulated.enable()
    kiwi.drive(0.5)
    ages: list[float] = []
    before = len(kiwi.bus.aimed)
    for _ in range(60):
        kiwi.drive(0.033)
        ages += [joint.age_s for joint in kiwi.arm.state.joints.values()]
    assert kiwi.bus.collisions == 0
    assert sorted(ages)[len(ages) // 2] < 0.035
    assert max(ages) < 0.1
    came = [at_ns for at_ns, servo in kiwi.bus.aimed[before:] if servo == IDS["roll"]]
    late_ns = sorted(abs(after - first - 40 * MS) for first, after in pairwise(came))
    assert len(late_ns) > 40
    assert late_ns[-1 - len(late_ns) // 100] < 5 * MS
    seen = [joint.pulses for joint in kiwi.arm.state.joints.values()]
    assert seen == pytest.approx(kiwi.at(POSITION_AT), abs=0.06 * SPEED * PER_RAD)


@pytest.mark.slow
def test_a_joint_that_lags_behind_its_goal_is_held_where_it_is(kiwi: Kiwi) -> None:
    blocked = IDS["elbow"]
    kiwi.drive(0.3)
    kiwi.bus.blocked.add(blocked)
    kiwi.drive(0.5)
    behind = kiwi.bus.word(blocked, codec.GOAL_POSITION) - kiwi.bus.word(blocked, POSITION_AT)
    assert behind > 50
    kiwi.simulated.robot.estop("hand in the arm")
    kiwi.simulated.wait(1.0)
    assert kiwi.bus.word(blocked, codec.GOAL_POSITION) == kiwi.bus.word(blocked, POSITION_AT)
    assert kiwi.torques() == {1}


def test_each_servo_s_load_and_temperature_are_told(kiwi: Kiwi) -> None:
    loaded, hot_wheel = kiwi.bus.memory[IDS["elbow"]], kiwi.bus.memory[8]
    loaded[60:62], hot_wheel[63] = (0x400 | 412).to_bytes(2, "little"), 70
    kiwi.simulated.wait(8.0)
    found = kiwi.simulated.robot.state.servos
    assert found["joint elbow (servo 3)"] == (-0.41, 31)
    assert found["rear wheel (servo 8)"] == (0.0, 70)
    assert len(found) == 9
    assert servos.summary(found) == (
        "rear wheel (servo 8) at 70 C is the hottest, joint elbow (servo 3) bears the most, 41%"
    )
    assert servos.hot(found, Settings({"board.kind": "feetech"})) == ["rear wheel (servo 8) is at 70 C"]
    assert servos.hot(found, Settings({"board.kind": "feetech", "arm.hot_c": 71})) == []


def test_a_base_without_an_arm_tells_of_its_wheels() -> None:
    simulated = Simulated(kind="feetech")
    simulated.wait(1.0)
    assert list(simulated.robot.state.servos) == [
        "left wheel (servo 7)",
        "rear wheel (servo 8)",
        "right wheel (servo 9)",
    ]

"""What the state interfaces show, and that each wheel of each base follows its own joint."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.policy import causes
from failstop_lab.controller_manager import Manager
from failstop_lab.trial import Trial
from tests.support.comma import comma_locale
from tests.support.waiting import until

from .scene import drive, managed, needs_compiler, trials, turns, urdf

pytestmark = [needs_compiler(), pytest.mark.slow]
RATIO = 0.17165 / 0.17706
"""Track by wheelbase of the default settings."""


def test_positions_and_velocities_are_measured(manager: Manager, trial: Trial) -> None:
    drive(manager, trial)
    before = manager.values()
    until(lambda: manager.values()["left_wheel_joint/position"] > before["left_wheel_joint/position"] + 1.0, "a way")
    values = manager.values()
    measured = trial.robot.state.turning.speeds_radps
    assert measured is not None
    assert values["left_wheel_joint/velocity"] == pytest.approx(measured.left, abs=1.0)
    assert values["failstop/enabled"] == 1.0
    assert values["failstop/turning"] == 2.0
    manager.send("unclaim")
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    until(lambda: manager.values()["left_wheel_joint/velocity"] == 0.0, "wheels that are reported at rest")
    # A position goes on where it was: a jump would be a jump of the odometry.
    at_rest = manager.values()["left_wheel_joint/position"]
    manager.send("to deactivate", "to cleanup", "to configure", "to activate")
    manager.until("state active", 2)
    manager.turn(5)
    assert manager.values()["left_wheel_joint/position"] == pytest.approx(at_rest, abs=0.2)


def test_each_wheel_of_a_differential_base_follows_its_joint(manager: Manager, trial: Trial) -> None:
    drive(manager, trial)
    manager.set({"left_wheel_joint/velocity": -1.5, "right_wheel_joint/velocity": 1.5})
    until(lambda: trial.board.wheels()[0] < 0.0 < trial.board.wheels()[1], "a turn to the left")

    def on_the_spot() -> bool:
        told = trial.robot.state.wheels_radps
        return told.left == pytest.approx(-told.right, abs=0.01) and told.right > 0.5

    until(on_the_spot, "the ramp from straight on to end in a turn on the spot")


@pytest.fixture(scope="module")
def mecanum(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    yield from trials("ros2-mecanum", tmp_path_factory.mktemp("mecanum"))


@pytest.fixture(scope="module")
def ackermann(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    more = {"wheels.layout": "ackermann"}
    yield from trials("ros2-ackermann", tmp_path_factory.mktemp("ackermann"), **more)


def test_each_wheel_of_a_mecanum_base_follows_its_joint(mecanum: Trial, tmp_path: Path) -> None:
    with managed("jazzy", urdf("mecanum", service=mecanum.name), tmp_path) as manager:
        drive(manager, mecanum, 1.0)
        # To the left: the front left and the rear right wheel turn backward.
        way = {"front_left": -1.0, "rear_left": 1.0, "front_right": 1.0, "rear_right": -1.0}
        manager.set({f"{name}_wheel_joint/velocity": sign for name, sign in way.items()})
        until(lambda: mecanum.robot.state.body_vel.vy_mps > 0.03, "motion to the left")
        state = mecanum.robot.state
        assert state.body_vel.vx_mps == pytest.approx(0.0, abs=0.005)
        for name, sign in way.items():
            assert math.copysign(1.0, getattr(state.wheels_radps, name)) == sign, name
        values = manager.values()
        assert math.isnan(values["imu/orientation.w"])
        until(lambda: math.isfinite(manager.values()["imu/linear_acceleration.z"]), "the IMU")
        assert manager.values()["imu/linear_acceleration.z"] == pytest.approx(9.81, abs=1.0)
        until(lambda: manager.values()["battery/voltage"] > 5.0, "the battery")
        # This board reports no wheels, so positions are those of the commands.
        assert "the board has reported no wheels yet" in manager.logged
        before = manager.values()["rear_left_wheel_joint/position"]
        until(lambda: manager.values()["rear_left_wheel_joint/position"] > before + 0.3, "a way by the commands")


@pytest.mark.parametrize("middle", [0.25, -0.25])
def test_the_steered_wheels_of_an_ackermann_base(ackermann: Trial, tmp_path: Path, middle: float) -> None:
    steered(ackermann, tmp_path, middle)


def test_numbers_are_the_same_where_a_comma_is_the_decimal_point(
    ackermann: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in comma_locale(tmp_path).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("FAILSTOP_STANDIN_LOCALE", "")
    steered(ackermann, tmp_path / "manager", 0.25)


def steered(ackermann: Trial, tmp_path: Path, middle: float) -> None:
    """Have a controller turn each steered wheel as a base does that turns by this angle in the middle, rad."""
    with managed("kilted", urdf("ackermann", service=ackermann.name), tmp_path) as manager:
        drive(manager, ackermann, 1.0)
        # By the point about which all wheels turn, on the line of the rear axle.
        radius = 1.0 / math.tan(middle)
        angles = {
            "front_left_steering_joint/position": math.atan(1.0 / (radius - RATIO / 2)),
            "front_right_steering_joint/position": math.atan(1.0 / (radius + RATIO / 2)),
        }
        manager.set(angles)

        def turned() -> bool:
            vx, _, wz = ackermann.robot.state.body_vel
            return vx > 0.035 and wz == pytest.approx(vx * math.tan(middle) / 0.17706, rel=0.03)

        until(turned, "a turn by the angle in the middle")
        until(lambda: abs(manager.values()["front_left_steering_joint/position"]) > 0.1, "the angle")
        values = manager.values()
        for name, angle in angles.items():
            assert values[name] == pytest.approx(angle, abs=0.02), name
        manager.send("unclaim")
        ackermann.board.wait_wheels(turning=False, timeout_s=5.0)
        ackermann.robot.disable()


def test_two_joints_may_drive_one_wheel(trial: Trial, tmp_path: Path) -> None:
    """A base with four wheels and two motors: the joints of a side count by their mean."""
    text = urdf("diff", service=trial.name)
    block = text[text.index('<joint name="left_wheel_joint">') :]
    joint = block[: block.index("</joint>") + len("</joint>")]
    more = joint.replace("left_wheel_joint", "left_rear_joint")
    with managed("lyrical", text.replace(joint, joint + more), tmp_path) as manager:
        drive(manager, trial)
        manager.set(dict.fromkeys((f"{name}/velocity" for name in manager.joints), 2.0))
        manager.set({"left_rear_joint/velocity": 1.0})
        until(lambda: trial.robot.state.wheels_radps.left == pytest.approx(1.5, abs=0.01), "the mean")
        assert trial.robot.state.wheels_radps.right == pytest.approx(2.0, abs=0.01)
        turns(manager, trial)
        # A joint that nobody has claimed does not slow down its wheel.
        manager.send("unclaim left_rear_joint/velocity")
        until(lambda: trial.robot.state.wheels_radps.left == pytest.approx(2.0, abs=0.01), "the claimed joint alone")
        # Nor does one that is no number turn the other wheels.
        manager.set({"left_wheel_joint/velocity": math.nan})
        trial.board.wait_wheels(turning=False, timeout_s=5.0)


def test_a_wheel_that_no_controller_has_claimed_stands_still(manager: Manager, trial: Trial) -> None:
    manager.until("state active")
    right = "right_wheel_joint/velocity"
    manager.claim(right)
    manager.set({right: 0.0, "left_wheel_joint/velocity": 3.0})
    manager.turn(2)
    trial.enable()
    manager.set({right: 2.0})
    until(lambda: trial.robot.state.wheels_radps.right == pytest.approx(2.0, abs=0.01), "the claimed wheel")
    assert trial.robot.state.wheels_radps.left == pytest.approx(0.0, abs=0.01)
    # In the place of it, another controller takes the other wheel.
    manager.send(f"unclaim {right}")
    manager.claim("left_wheel_joint/velocity")
    manager.set({"left_wheel_joint/velocity": -2.0})
    until(lambda: trial.robot.state.wheels_radps.left == pytest.approx(-2.0, abs=0.01), "the other wheel")
    assert trial.robot.state.wheels_radps.right == pytest.approx(0.0, abs=0.01)


def test_what_a_controller_sees_of_an_emergency_stop(trial: Trial, tmp_path: Path) -> None:
    """It goes on commanding all the while."""
    text = urdf("diff", service=trial.name)
    more = "".join(f'<state_interface name="{name}"/>' for name in ("cause", "moving", "ready", "link"))
    text = text.replace('<state_interface name="latched"/>', f'<state_interface name="latched"/>{more}')
    with managed("lyrical", text, tmp_path) as manager:
        drive(manager, trial)
        until(lambda: manager.values()["failstop/moving"] == 1.0, "the motion in a state interface")
        driven = manager.values()
        assert (driven["failstop/enabled"], driven["failstop/latched"], driven["failstop/blocked"]) == (1.0, 0.0, 0.0)
        assert (driven["failstop/cause"], driven["failstop/link"]) == (0.0, 1.0)
        trial.robot.estop("a hand near the wheel")
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        until(lambda: manager.values()["failstop/latched"] == 1.0, "the latch in a state interface")
        latched = manager.values()
        assert (latched["failstop/enabled"], latched["failstop/moving"], latched["failstop/blocked"]) == (0.0, 0.0, 1.0)
        assert latched["failstop/cause"] == causes.REQUESTED.number
        until(lambda: manager.values()["left_wheel_joint/velocity"] == 0.0, "wheels that are reported at rest")
        until(lambda: "a hand near the wheel" in manager.logged, "the cause in the log")
        # A computer may have several services, so what a person should type names the one of this robot.
        assert f"next: failstop enable --name {trial.name}" in manager.logged
        rests = manager.values()["left_wheel_joint/position"]
        assert rests >= driven["left_wheel_joint/position"]
        until(trial.reset, "the reset")
        trial.board.events()
        trial.robot.enable()
        # The controller has commanded since before: nothing moves until it commands zero.
        until(lambda: manager.values()["failstop/blocked"] == 3.0, "the held command in a state interface")
        manager.turn(5)
        assert not any(event.is_motion for event in trial.board.events())
        until(lambda: "let it command zero" in manager.logged, "what to do in the log")
        assert manager.values()["left_wheel_joint/position"] == pytest.approx(rests, abs=0.2)
        manager.set({f"{name}/velocity": 0.0 for name in manager.joints})
        manager.turn(2)
        manager.set({f"{name}/velocity": 3.0 for name in manager.joints})
        turns(manager, trial)
        until(lambda: manager.values()["failstop/blocked"] == 0.0, "the motion in a state interface")

"""LeRobot's own scripts on the plugin, with the real LeRobot: teleoperation, recording, replay. The simulated board
says what moved."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from failstop_lab.faults.arm import ArmTrial
from failstop_lab.trial import wait_for

from .scene import HERE, JOINTS, KIWI, RANGES, LeRobot, of_the_page, started

pytestmark = pytest.mark.timeout(900)
SCRIPTED = str(HERE / "scripted.py")
AT = {1: 540, 2: 440, 3: 580, 4: 580, 5: 580, 10: 440}
"""Pulses by servo where every joint's number is 20, by hand: of the inverted one 800 - 0.6 * 600."""
AT_DEGREES = {1: 583, 2: 583, 3: 583, 4: 583, 5: 583, 10: 440}
"""The same in degrees: 500 is the middle of each range, and 1500 pulses are a turn. The gripper has no degrees."""


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> LeRobot:
    return LeRobot("real", tmp_path_factory.mktemp("real"))


def options(trial: ArmTrial, **more: Any) -> list[str]:
    """Those of LeRobot's command line for the robot."""
    given = {"type": "failstop", "id": "kiwi", "service": trial.name, "joints": json.dumps(JOINTS), **more}
    return [f"--robot.{name}={value}" for name, value in given.items()]


def near(trial: ArmTrial, real: LeRobot) -> bool:
    at = trial.board.joints()
    wanted = AT_DEGREES if real.facts["kiwi"]["norm modes"]["arm_shoulder_pan"] == "degrees" else AT
    return all(abs(at[servo] - pulses) <= 2 for servo, pulses in wanted.items())


def away(trial: ArmTrial, real: LeRobot) -> None:
    """Move every joint from there by hand, and have it read."""
    for servo, _, low, high in RANGES.values():
        trial.board.servo(servo, position=(low + high) / 2)
    trial.robot.arm.read()
    trial.leave()
    assert not near(trial, real)


def test_teleoperation_moves_the_arm(real: LeRobot, trial: ArmTrial) -> None:
    away(trial, real)
    real.run(SCRIPTED, "teleoperate", *options(trial), "--teleop.type=scripted", "--teleop_time_s=2")
    assert near(trial, real)
    assert not trial.board.limp()


def test_teleoperation_drives_the_base(real: LeRobot, trial: ArmTrial) -> None:
    mark = trial.board.info()["executed"]
    teleop = ("--teleop.type=scripted", "--teleop.x=0.1", "--teleop_time_s=1")
    real.run(SCRIPTED, "teleoperate", *options(trial, enable="true"), *teleop)
    assert [event for event in trial.board.events(mark) if event.is_motion]
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)


def test_a_leader_arm_and_a_keyboard_at_once(real: LeRobot, trial: ArmTrial) -> None:
    mark = trial.board.info()["executed"]
    real.run(SCRIPTED, "both", trial.name, *(f"{name}={of_settings}" for name, of_settings in JOINTS.items()))
    speeds = [event.speeds for event in trial.board.events(mark) if event.is_motion]
    assert speeds
    trial.board.wait_wheels(turning=False, timeout_s=5.0)


def test_what_was_recorded_is_replayed(real: LeRobot, trial: ArmTrial, tmp_path: Path) -> None:
    away(trial, real)
    dataset = (f"--dataset.root={tmp_path}/set", "--dataset.repo_id=me/kiwi", "--play_sounds=false")
    recorded = ("--dataset.num_episodes=1", "--dataset.episode_time_s=2", "--dataset.single_task=reach")
    here = ("--dataset.push_to_hub=false", "--dataset.video=false")
    real.run(SCRIPTED, "record", *options(trial), "--teleop.type=scripted", *dataset, *recorded, *here)
    assert near(trial, real)
    told = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert told["robot_type"] == KIWI["name"]
    assert told["features"]["action"]["names"] == list(KIWI["actions"])
    assert told["features"]["observation.state"]["names"] == list(KIWI["observations"])
    assert told["total_frames"] > 30
    away(trial, real)
    real.run(SCRIPTED, "replay", *options(trial), *dataset, "--dataset.episode=0")
    assert near(trial, real)


def test_the_wheels_stand_when_the_laptop_ends_and_when_the_host_does(real: LeRobot, trial: ArmTrial) -> None:
    with ExitStack() as rest:
        listening = [rest.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2)]
        ports = [str(one.getsockname()[1]) for one in listening]
    words = [f"--host.port_zmq_cmd={ports[0]}", f"--host.port_zmq_observations={ports[1]}"]
    host = ("-c", of_the_page("lekiwi_host", trial.name), "--host.connection_time_s=600", *words)
    trial.robot.enable()
    with started(real, *host) as running:
        with started(real, SCRIPTED, "client", *ports):
            trial.board.wait_wheels(turning=True, timeout_s=200.0)
        trial.board.wait_wheels(turning=False, timeout_s=10.0)
        assert trial.robot.state.enabled
        with started(real, SCRIPTED, "client", *ports):
            trial.board.wait_wheels(turning=True, timeout_s=200.0)
            mark = trial.board.info()["executed"]
            running.kill()
            stop = trial.board.wait_for(lambda event: event.is_motor and not any(event.speeds), 10.0, mark)
            wait_for("the gate's word", lambda: not trial.robot.state.enabled)
            assert not [event for event in trial.board.events(stop.index + 1) if event.is_motion]

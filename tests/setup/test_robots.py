"""The robots that setup knows: each file is valid, and a service with its settings starts, drives and stops."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.board.kinds import is_described
from failstop.policy.layouts import BOARDS
from failstop.policy.scale import PER_RPS, PER_RPS_CONFIRMED
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.setup import finish, robots
from failstop.setup.command import layouts_of
from failstop.supervisor.fit import checked_board
from failstop_lab.boards.line import model_of
from tests.support.simulated import Simulated

FILES = sorted(robots.FOLDER.glob("*.toml"))
CURVE = (0.1, 0.0, 0.2)
"""In which every wheel turns."""


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_its_settings_are_those_of_a_robot_that_the_board_can_drive(file: Path) -> None:
    robot = robots.read(file)
    assert robot.kind in BOARDS
    assert robots.of_kind(robot.kind)[robot.key] == robot
    assert checked_board(Settings(dict(robot.settings)), str(file)).wheels
    written = finish.text(dict(robot.settings), robot.name, {}).split("\n")
    assert max(len(line) for line in written if line.startswith("#")) <= 77, "setup shows it, with an indent of three"


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_service_with_its_settings_starts_drives_and_stops(file: Path) -> None:
    robot = robots.read(file)
    board = checked_board(Settings(dict(robot.settings)), str(file))
    known = {PER_RPS: board.per_rps, PER_RPS_CONFIRMED: board.per_rps} if board.scale_assumed else {}
    motors = board.wheels if is_described(robot.kind) and model_of(robot.kind).with_motors else 0
    simulated = Simulated({**robot.settings, **known, "scan.gate": "off"}, kind=robot.kind, motors=motors)
    simulated.enable()
    simulated.drive(0.6, CURVE)
    turning = [speed for speed in simulated.board.wheels() if speed]
    assert len(turning) == len([key for key in Settings(dict(robot.settings)).flat() if key.startswith("wheels.id_")])
    simulated.robot.estop("enough")
    simulated.wait(0.5)
    assert not any(simulated.board.wheels())
    assert simulated.robot.state.last_stop.acknowledged_s is not None


@pytest.mark.parametrize(
    ("kind", "layouts"),
    [
        ("damiao", ["mecanum", "differential", "omni3"]),
        ("vesc", ["differential", "ackermann"]),
        ("feetech", ["differential", "omni3"]),
        ("rrc", ["mecanum", "differential", "omni3", "ackermann"]),
    ],
)
def test_for_another_robot_setup_offers_the_layouts_of_its_board(kind: str, layouts: list[str]) -> None:
    assert layouts_of(kind) == layouts


def test_a_robot_without_a_fixed_size_says_what_to_measure() -> None:
    base = robots.of_kind("damiao")["openarm-base"]
    assert "measure" in base.measure
    assert not any(key.endswith("_m") for key in base.settings)


def test_a_file_without_a_name_is_named(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text('board.kind = "ugv"\nwheels.layout = "differential"\n')
    with pytest.raises(SettingError, match=r"robot\.toml: a robot needs about\.name"):
        robots.read(file)

"""A calibration file of LeRobot's becomes failstop's settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from lerobot_robot_failstop.__main__ import main

from failstop import config
from failstop.cli.commands.config import example

from .scene import CALIBRATION, RANGES

WITHOUT = {name: row for name, row in CALIBRATION.items() if name != "arm_gripper"}


def changed(name: str, **values: Any) -> dict[str, Any]:
    return CALIBRATION | {f"arm_{name}": {**CALIBRATION[f"arm_{name}"], **values}}


EMPTY = CALIBRATION | {"arm_gripper": {**CALIBRATION["arm_gripper"], "range_min": 600}}


def test_the_settings_have_the_servos_and_ranges_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "kiwi.json"
    file.write_text(json.dumps(CALIBRATION))
    assert main([str(file)]) == 0
    settings = tmp_path / "arm.toml"
    settings.write_text(capsys.readouterr().out)
    found = config.load(str(settings)).named["joints"]
    wanted = {name: (servo, low, high) for name, (servo, _, low, high) in RANGES.items()}
    assert {name: (row["servo"], row["low"], row["high"]) for name, row in found.items()} == wanted
    assert found["gripper"]["zero"] == 500


def test_an_offset_is_kept_for_lerobot_s_host_at_the_guard_port(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "kiwi.json"
    file.write_text(json.dumps(CALIBRATION | {"arm_gripper": {**CALIBRATION["arm_gripper"], "homing_offset": -1043}}))
    assert main([str(file)]) == 0
    settings = tmp_path / "arm.toml"
    settings.write_text(capsys.readouterr().out)
    found = {name: row["offset"] for name, row in config.load(str(settings)).named["joints"].items()}
    assert found == {**dict.fromkeys(found, 0), "gripper": -1043}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "kiwi.json: No such file or directory: check the path\n"),
        ("{", "it is no JSON (Expecting property name"),
        ("{", "is it LeKiwi's calibration?"),
        ("[]", "is it LeKiwi's calibration?"),
        (json.dumps(WITHOUT), "no arm_gripper with id, range_min, range_max: is it LeKiwi's calibration?"),
        (json.dumps(EMPTY), "arm_gripper has a range from 600 to 600: calibrate it again"),
        (json.dumps(changed("elbow_flex", range_min=0, range_max=4095)), "are more than this joint can turn"),
        (json.dumps(changed("shoulder_pan", range_min=200, range_max=3701)), "3501 of 4096 steps are more than"),
        (json.dumps(changed("gripper", range_min=2000, range_max=2003)), "3 steps are no joint's range: calibrate it"),
        (json.dumps(changed("wrist_roll", range_min=-1, range_max=4000)), "a servo has the steps 0 to 4095"),
        (json.dumps(changed("wrist_roll", range_min=0, range_max=4096)), "a servo has the steps 0 to 4095"),
        (json.dumps(changed("elbow_flex", id=2)), "but they must differ"),
        (
            json.dumps(changed("elbow_flex", id=8)),
            "on board.kind feetech, that is the id of a wheel",
        ),
        (json.dumps(changed("elbow_flex", id=0)), "joints.elbow_flex.servo = 0: it must be 1 to 100"),
        (json.dumps(changed("elbow_flex", id=True)), "no arm_elbow_flex with id, range_min, range_max"),
        (json.dumps(changed("elbow_flex", range_min=100.5)), "no arm_elbow_flex with id, range_min, range_max"),
        ("[" * 100_000, "its lists are nested too deeply: is it LeKiwi's calibration?"),
    ],
)
def test_what_is_no_calibration_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: Any, told: str
) -> None:
    file = tmp_path / "kiwi.json"
    if text is not None:
        file.write_text(text)
    assert main([str(file)]) == 1
    out, err = capsys.readouterr()
    assert out == "", "nothing is appended"
    assert told in err
    assert err.count("\n") == 1
    assert main([]) == 2


def test_ranges_at_the_bounds_are_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "kiwi.json"
    for name, low, high in (("wrist_roll", 0, 4095), ("elbow_flex", 300, 3800), ("gripper", 0, 100)):
        file.write_text(json.dumps(changed(name, range_min=low, range_max=high)))
        assert main([str(file)]) == 0, capsys.readouterr().err


def test_they_can_be_added_at_the_end_of_the_shipped_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As docs/lekiwi.md says, by `tee -a`; and a line more after them."""
    file = tmp_path / "kiwi.json"
    file.write_text(json.dumps(CALIBRATION))
    assert main([str(file)]) == 0
    settings = tmp_path / "failstop.toml"
    settings.write_text(example() + capsys.readouterr().out + 'device.path = "/dev/ttyACM1"\n')
    found = config.load(str(settings))
    assert (found.text("board.kind"), found.text("device.path")) == ("feetech", "/dev/ttyACM1")
    assert len(found.named["joints"]) == 6

"""The examples are what the declarations say, and right; so is the page on settings."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest

from failstop import config
from failstop.cli import main as cli
from failstop.policy import kinematics
from failstop.policy.settings import DECLARED, FAMILIES, Settings
from failstop_lab.pages import settings as page_of_settings

ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLES = ROOT / "examples"
COMPLETE = EXAMPLES / "failstop.toml"


def test_the_example_and_the_page_on_settings_are_the_generated_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "--example"]) == 0
    assert COMPLETE.read_text() == capsys.readouterr().out, "renew it: make docs"
    assert (ROOT / "docs" / "reference" / "settings.md").read_text() == page_of_settings.page(), "renew it: make docs"


def uncommented(text: str) -> str:
    """With the defaults set; samples, whose # has a space behind it, stay comments."""
    return re.sub(r"^#(\w+ = )", r"\1", text, flags=re.MULTILINE)


def test_the_complete_example_sets_the_device_alone() -> None:
    assert {key for key, value in config.read(str(COMPLETE)).items() if value != {}} == {"device.path"}
    assert config.load(str(COMPLETE)).flat() == Settings().flat()


def test_the_complete_example_has_every_setting_with_its_default(tmp_path: Path) -> None:
    file = tmp_path / "all.toml"
    file.write_text(uncommented(COMPLETE.read_text()))
    read = config.read(str(file))
    flat = Settings().flat()
    del flat["sources.cmd_vel.timeout_s"]  # it follows gate.command_timeout_s, which is there
    assert read == flat
    others = {setting.key for setting in DECLARED} - read.keys()
    assert all(re.search(f"^##{key.partition('.')[2]} = ", COMPLETE.read_text(), re.MULTILINE) for key in others)


def test_each_setting_of_the_example_says_what_it_is_and_what_is_allowed() -> None:
    lines = COMPLETE.read_text().splitlines()
    commented = {(line.partition(" = ")[0].lstrip("#"), above) for above, line in pairwise(lines) if " = " in line}
    for setting in DECLARED:
        name = setting.key.partition(".")[2]
        assert any(
            key == name and above.lower().startswith(f"# {setting.doc.lower()} [") and setting.range() in above
            for key, above in commented
        ), setting.key


def test_the_samples_in_the_example_are_right_when_uncommented(tmp_path: Path) -> None:
    text = COMPLETE.read_text()
    for family in FAMILIES:
        assert re.search(rf"^# \[{family}\.", text, re.MULTILINE)
    file = tmp_path / "all.toml"
    file.write_text(re.sub(r"^# (\[|\w+ = )", r"\1", uncommented(text), flags=re.MULTILINE))
    settings = config.load(str(file))
    assert settings.sources() == {"teleop": (10, 300_000_000), "cmd_vel": (0, 300_000_000)}
    assert settings.interlocks() == {
        "arm": (500_000_000, "arm is not in the drive pose"),
        "ros2": (300_000_000, "the ROS 2 bridge is away, or two nodes publish cmd_vel"),
    }


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.name)
def test_every_example_passes_the_check(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "--check", str(path)]) == 0
    assert capsys.readouterr().out.startswith(f"{path} is right; ")


def test_the_profile_of_the_robot() -> None:
    settings = config.load(str(EXAMPLES / "rosorin.toml"))
    assert (settings["limits.vx_mps"], settings["limits.vy_mps"], settings["limits.wz_radps"]) == (0.35, 0.35, 1.0)
    assert [settings[f"imu.offset_{axis}_g"] for axis in "xyz"] == [0.0460, -0.0635, -0.0501]
    assert [settings[f"imu.scale_{axis}"] for axis in "xyz"] == [1.0058, 0.9964, 1.0076]
    assert list(settings.sources()) == ["teleop", "cmd_vel"], "teleop goes before the navigation"
    speeds = kinematics.from_settings(settings).wheels_rps(0.2, 0.0, 0.0)
    assert [f"{rps:.3f}" for rps in speeds] == ["0.796", "0.796", "-0.796", "-0.796"]
    defaults = Settings().flat()
    for key, value in config.read(str(EXAMPLES / "rosorin.toml")).items():
        assert key not in defaults or value != defaults[key], f"{key}: it says only what differs"

"""The examples are what the declarations say, and right; so is the page on settings."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest

from failstop import config
from failstop.cli import main as cli
from failstop.cli.commands.config import literal
from failstop.fleet import settings as fleet
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
    return re.sub(r"^#([\w.]+ = )", r"\1", text, flags=re.MULTILINE)


def test_the_complete_example_sets_nothing() -> None:
    assert not config.read(str(COMPLETE))


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.name)
def test_any_setting_can_be_added_at_the_end_of_an_example(file: Path, tmp_path: Path) -> None:
    """Our pages tell people to add lines, and `tee -a` adds them after whatever is there."""
    set_already = config.read(str(file))
    longer = tmp_path / "longer.toml"
    for setting in DECLARED:
        if setting.key not in set_already:
            line = f"{setting.key} = {literal(setting, setting.default)}\n"
            longer.write_text(file.read_text() + line)
            assert config.read(str(longer))[setting.key] == setting.default


def test_every_line_of_settings_on_our_pages_has_its_whole_name(tmp_path: Path) -> None:
    """Below a [table] of the file, it would be another setting; a [table] of ours might be in the file already."""
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for block in re.findall(r"^ *```toml\n(.*?)^ *```", page.read_text(), re.MULTILINE | re.DOTALL):
            assert not re.search(r"^ *\[", block, re.MULTILINE), f"{page.name}: {block}"


def test_the_fleet_s_example_sets_nothing_and_can_be_added_to(tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(fleet.example() + 'broker.host = "hub"\n')
    assert config.read(str(file)) == {"broker.host": "hub"}
    given = re.findall(r"^#([\w.]+) = ", fleet.example(), re.MULTILINE)
    assert given == [row.key for row in fleet.DECLARED]
    file.write_text(re.sub("^#(?=\\w)", "", fleet.example(), flags=re.MULTILINE))
    assert config.read(str(file)) == {row.key: row.default for row in fleet.DECLARED}


def test_the_complete_example_has_every_setting_with_its_default(tmp_path: Path) -> None:
    file = tmp_path / "all.toml"
    file.write_text(uncommented(COMPLETE.read_text()))
    read = config.read(str(file))
    flat = Settings().flat()
    del flat["sources.cmd_vel.timeout_s"]  # it follows gate.command_timeout_s, which is there
    assert read == flat
    others = {setting.key for setting in DECLARED} - read.keys()
    assert all(re.search(f"^##{re.escape(key)} = ", COMPLETE.read_text(), re.MULTILINE) for key in others)


def test_each_setting_of_the_example_says_what_it_is_and_what_is_allowed() -> None:
    lines = COMPLETE.read_text().splitlines()
    commented = {(line.partition(" = ")[0].lstrip("#"), above) for above, line in pairwise(lines) if " = " in line}
    for setting in DECLARED:
        assert any(
            key == setting.key and above.lower().startswith(f"# {setting.doc.lower()} [") and setting.range() in above
            for key, above in commented
        ), setting.key


def test_the_samples_in_the_example_are_right_when_uncommented(tmp_path: Path) -> None:
    text = COMPLETE.read_text()
    for family in FAMILIES:
        assert re.search(rf"^# {family}\.", text, re.MULTILINE)
    file = tmp_path / "all.toml"
    file.write_text(re.sub(r"^# ([\w.]+ = )", r"\1", uncommented(text), flags=re.MULTILINE))
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

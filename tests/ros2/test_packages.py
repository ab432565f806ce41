"""The ROS packages of the folder failstop/ros2/packages, and docs/ros2.md, against the code that they are of."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from failstop.ros2 import contract, report
from failstop.version import VERSION
from failstop_lab.pages import ros2, ros_changes
from tests.support import states

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "failstop" / "ros2" / "packages"


@pytest.mark.parametrize("name", ["failstop_ros2", "failstop_msgs"])
def test_manifest(name: str) -> None:
    root = ElementTree.parse(PACKAGES / name / "package.xml").getroot()
    assert (root.findtext("name"), root.findtext("version")) == (name, VERSION)
    maintainer = root.find("maintainer")
    assert maintainer is not None
    assert re.fullmatch(r"[-\w.]+@[-\w]+\.\w+", maintainer.get("email", "")), "catkin_pkg refuses it otherwise"


def test_the_changes_of_a_package_are_those_that_name_it_as_bloom_reads_them() -> None:
    changes = "# Changes\n\n## Unreleased\n\n- The [page](x.md) of\n  ROS 2: `a`.\n- Arms.\n\n## 0.1.0 (2026-11-22)\n"
    lines = ros_changes.text("failstop_ros2", changes).splitlines()
    title, underlined = "Changelog for package failstop_ros2", "-" * len("0.1.0 (2026-11-22)")
    assert lines[:3] == ["^" * len(title), title, "^" * len(title)]
    assert lines[5:9] == ["", "Forthcoming", "-----------", "* The page of ROS 2: ``a``."]
    assert lines[9:] == ["", "0.1.0 (2026-11-22)", underlined, "* No change of this package."]


def test_setup_is_of_this_version() -> None:
    assert f'version="{VERSION}"' in (PACKAGES / "failstop_ros2/setup.py").read_text()


def test_every_message_package_that_is_used_is_depended_on() -> None:
    rows = [*contract.INWARD, *contract.OUTWARD, contract.TF, *contract.SERVICES]
    rows += [contract.ARM_GOAL, contract.ARM_BUSY, *contract.ARM_SERVICES, contract.ARM_ACTION]
    used = {row.type.partition("/")[0] for row in rows}  # type: ignore[attr-defined]
    for path in (PACKAGES.parent).glob("*.py"):
        used |= set(re.findall(r"^ +from (rclpy|\w+_interfaces)\b", path.read_text(), re.MULTILINE))
    assert "rcl_interfaces" in used
    root = ElementTree.parse(PACKAGES / "failstop_ros2/package.xml").getroot()
    assert used <= {row.text for row in root.iter("exec_depend")}


def test_every_key_that_is_ours_leads_to_a_package_of_a_release() -> None:
    keys = (ROOT / "packaging/rosdep.yaml").read_text()
    told = dict(re.findall(r"^([\w-]+):\n((?:  .*\n)+)", keys, re.MULTILINE))
    for system, package in re.findall(r"^  (\w+): \[([\w-]+)\]$", "".join(told.values()), re.MULTILINE):
        assert system in ("debian", "ubuntu")
        assert f"Package: {package}\n" in (ROOT / f"packaging/deb/{package}.control").read_text()
    used = set()
    for folder in ros_changes.FOLDERS.values():
        manifest = ElementTree.parse(ROOT / folder / "package.xml").getroot()
        used |= {row.text for row in manifest if "depend" in row.tag and "failstop" in str(row.text)}
    assert used - set(ros_changes.FOLDERS) == set(told)


def test_what_colcon_leaves_is_read_by_no_tool() -> None:
    """ruff leaves out what git ignores; mypy has a pattern of its own."""
    ignored = (ROOT / ".gitignore").read_text().splitlines()
    assert {"build/", "/failstop/ros2/**/install/", "/failstop/ros2/**/log/"} <= set(ignored)
    excluded = re.findall(r'^exclude = \[.*"(ros2/[^"]+)"', (ROOT / "pyproject.toml").read_text(), re.M)
    for folder in ("failstop/ros2", "failstop/ros2/packages"):
        for name in ("build", "install", "log"):
            assert re.search(excluded[0], f"{folder}/{name}/failstop_ros2/bridge.py")


def test_the_message_has_the_fields_that_are_filled() -> None:
    lines = (PACKAGES / "failstop_msgs/msg/Status.msg").read_text().splitlines()
    fields = {line.split()[1]: line.split()[0] for line in lines if line and not line.startswith("#")}
    assert fields.pop("stamp") == "builtin_interfaces/Time"
    kinds = {str: "string", bool: "bool", float: "float64"}
    assert fields == {name: kinds[type(value)] for name, value in report.status(states.latched()).items()}


def test_the_launch_file_declares_what_it_uses() -> None:
    text = (PACKAGES / "failstop_ros2/launch/failstop.launch.py").read_text()
    used = set(re.findall(r'LaunchConfiguration\("(\w+)"\)', text))
    assert used <= set(re.findall(r'^    "(\w+)": \(', text, re.MULTILINE))


def test_the_page_is_that_of_the_code() -> None:
    assert ros2.text() in (ROOT / "docs/ros2.md").read_text(), "renew it: make docs"


def test_the_line_for_the_launch_file_of_nav2_is_an_argument_of_a_node() -> None:
    """launch_ros takes a list of pairs."""
    page = (ROOT / "docs/ros2.md").read_text()
    [shown] = re.findall(r"^\+? *(remappings ?=.*cmd_vel_nav.*)$", page, re.MULTILINE)
    given = eval(f"dict({shown})", {"remappings": [("/tf", "tf")]})
    assert given == {"remappings": [("/tf", "tf"), ("cmd_vel", "cmd_vel_nav")]}

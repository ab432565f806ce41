"""What a URDF may say, in every release, and what is said of one that is wrong."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from failstop.policy.processes import PROCESSES, SUPERVISOR_PRIORITY
from failstop.version import VERSION
from failstop_lab.controller_manager import PLUGIN, RELEASES
from failstop_lab.trial import Trial

from .scene import URDFS, described, managed, needs_compiler, urdf

pytestmark = needs_compiler()


@pytest.mark.parametrize("release", RELEASES)
@pytest.mark.parametrize("base", ["ackermann", "diff", "mecanum"])
def test_each_example_is_taken_in_each_release(release: str, base: str, tmp_path: Path) -> None:
    with managed(release, urdf(base, service="ros2-nobody").replace(">10<", ">0<"), tmp_path) as manager:
        manager.until("on_configure FAILURE")
        assert manager.said[0] == "on_init SUCCESS"


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ('<param name="wheel">left</param>', "", "joint left_wheel_joint needs the parameter wheel"),
        ('<command_interface name="velocity"/>', '<command_interface name="effort"/>',
         "joint left_wheel_joint has the command interface effort: only one is possible, velocity"),
        ('<state_interface name="velocity"/>', '<state_interface name="effort"/>',
         "joint left_wheel_joint has the state interface effort: possible are position and velocity"),
        ('<state_interface name="voltage"/>', '<state_interface name="volts"/>',
         "sensor battery has the state interface volts: possible are enabled, "),
        ('<param name="wait_s">10<', '<param name="wait_s">soon<', "the parameter wait_s = soon: give the seconds"),
        ("</hardware>", '<param name="on_latched">stop</param></hardware>',
         "the parameter on_latched = stop: allowed is hold or error"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_at_the_start(before: str, after: str, told: str, tmp_path: Path) -> None:
    text = urdf("diff")
    assert before in text
    with managed("lyrical", text.replace(before, after, 1), tmp_path) as manager:
        manager.until("on_init ERROR")
        assert f"diff_base: {told}" in manager.logged


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (">left<", ">front_left<", "has the parameter wheel = front_left: this robot has left, right"),
        (">left<", ">right<", "no joint drives the wheel left: give one the parameter wheel = left"),
        ("</hardware>", '<param name="source">nav</param></hardware>', "no such source; add [sources.nav]"),
        ("</hardware>", '<param name="interlock">arm</param></hardware>', "no such interlock; add [interlocks.arm]"),
    ],
)
@pytest.mark.slow
def test_what_does_not_fit_the_service_is_named(
    trial: Trial, before: str, after: str, told: str, tmp_path: Path
) -> None:
    text = urdf("diff", service=trial.name).replace(before, after, 1)
    with managed("lyrical", text, tmp_path) as manager:
        manager.until("on_configure FAILURE")
        assert told in manager.logged
        assert not trial.robot.state.enabled


@pytest.mark.slow
def test_a_base_that_steers_needs_a_service_that_steers(trial: Trial, tmp_path: Path) -> None:
    with managed("lyrical", urdf("ackermann", service=trial.name), tmp_path) as manager:
        manager.until("on_configure FAILURE")
        assert "the service's base does not steer (setting wheels.layout)" in manager.logged


def test_a_service_that_no_service_can_have_as_its_name_is_named(tmp_path: Path) -> None:
    with managed("lyrical", urdf("diff", service="Left_Robot"), tmp_path) as manager:
        manager.until("on_configure FAILURE")
        told = "diff_base: the parameter service = Left_Robot: use 1 to 32 of a-z, 0-9, _ and -"
        assert told in manager.logged


def test_a_parameter_that_has_no_effect_is_named(tmp_path: Path) -> None:
    text = urdf("diff", service="ros2-nobody", more={"device": "/dev/ttyUSB0"}).replace(">10<", ">0<")
    with managed("lyrical", text, tmp_path) as manager:
        manager.until("on_configure FAILURE")
        assert "the parameter device has no effect on failstop" in manager.logged


def test_the_joints_of_an_example_are_in_its_urdf() -> None:
    for path in URDFS.glob("*.urdf"):
        root = ElementTree.parse(path).getroot()
        known = {joint.get("name") for joint in root.iterfind("joint")}
        listed = [line.split()[1] for line in described(path.read_text()) if line.startswith("joint ")]
        assert listed
        assert set(listed) <= known


@pytest.mark.parametrize("base", ["ackermann", "diff", "mecanum"])
def test_the_launch_file_and_the_controllers_of_an_example_fit(base: str) -> None:
    """No YAML parser is among failstop's dependencies, so the names are looked for in the text."""
    launched = re.search(rf'"{base}": \(([^)]*)\)', (PLUGIN / "launch" / "failstop.launch.py").read_text())
    assert launched is not None
    text = (PLUGIN / "config" / f"{base}.yaml").read_text()
    for controller in re.findall(r'"(\w+)"', launched[1]):
        assert re.search(rf"^    {controller}: \{{type: \w+/\w+\}}$", text, re.MULTILINE), controller
    joints = {line.split()[1] for line in described(urdf(base)) if line.startswith("joint ")}
    assert set(re.findall(r"\w+_joint\b", text)) == joints


def test_the_manifest() -> None:
    root = ElementTree.parse(PLUGIN / "package.xml").getroot()
    assert (root.findtext("name"), root.findtext("version")) == ("failstop_ros2_control", VERSION)
    made = ElementTree.parse(PLUGIN / "failstop_ros2_control.xml").getroot()
    plugin = made.find("class")
    assert plugin is not None
    assert plugin.get("name") == "failstop_ros2_control/System"
    names = {each.text for each in root.iterfind("exec_depend")}
    types = "".join(path.read_text() for path in (PLUGIN / "config").glob("*.yaml"))
    for controller in ("ackermann_steering", "diff_drive", "mecanum_drive"):
        assert f"{controller}_controller/" in types
        assert f"{controller}_controller" in names


@pytest.mark.parametrize("base", ["ackermann", "diff", "mecanum"])
def test_the_loop_of_each_example_runs_below_failstop(base: str) -> None:
    """ros2_control's default, 50, is above it: an endless loop there would leave failstop no processor if there is
    only one."""
    found = re.search(r"^    thread_priority: (\d+)$", (PLUGIN / "config" / f"{base}.yaml").read_text(), re.MULTILINE)
    assert found
    assert int(found[1]) < min(SUPERVISOR_PRIORITY, *(row.priority for row in PROCESSES))

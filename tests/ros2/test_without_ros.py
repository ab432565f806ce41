"""A machine without ROS 2, or without a package that the bridge needs: one line says what to do, once."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from failstop.cli import missing
from failstop.cli.missing import DISTRIBUTIONS, INCOMPLETE
from failstop.ros2.contract import SETTINGS

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "failstop/ros2/packages/failstop_ros2/launch/failstop.launch.py"
BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocked())
from failstop.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("sourced", [True, False])
def test_one_line_and_an_exit_code_that_nobody_restarts_it_for(sourced: bool) -> None:
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
    environment = clean | ({"AMENT_PREFIX_PATH": "/nowhere"} if sourced else {})
    done = subprocess.run(
        [sys.executable, "-m", "failstop", "ros2"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == INCOMPLETE
    assert done.stdout == ""
    said = " ".join(done.stderr.split())
    assert said.startswith("failstop: ")
    assert "setup.sh" in said or "install failstop for ROS's own Python" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("module", "name"), [("msgpack", "ros2"), ("msgpack", "status"), ("rclpy.callback_groups", "ros2")]
)
def test_a_package_that_is_missing_is_named_with_the_python_that_lacks_it(
    tmp_path: Path, module: str, name: str
) -> None:
    """The first is missing before the command begins, the other when the bridge makes its node."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests/ros2/standin"), "FAILSTOP_STANDIN": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", BLOCKED, module, name, "--name", "nobody-here"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        timeout=60,
    )
    assert done.returncode == INCOMPLETE
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith(
        f"failstop: Python {sys.version_info[0]}.{sys.version_info[1]} ({sys.executable}) can't"
    )
    assert f"can't import {module.partition('.')[0]} " in done.stderr


def test_every_dependency_has_its_remedy() -> None:
    [wanted] = re.findall(r"^dependencies = \[\n(.*?)^\]", (ROOT / "pyproject.toml").read_text(), re.M | re.S)
    assert sorted(pip for pip, _ in DISTRIBUTIONS.values()) == sorted(re.findall(r'"([\w-]+)>=', wanted))


@pytest.mark.parametrize(
    ("python", "module", "remedy"),
    [
        ("/usr/bin/python3", "msgpack", "`sudo apt install python3-msgpack`"),
        ("/usr/bin/python3", "posix_ipc", "`/usr/bin/python3 -m pip install posix-ipc`"),
        ("/opt/failstop/bin/python3", "msgpack", "`/opt/failstop/bin/python3 -m pip install msgpack`"),
        ("/usr/bin/python3", "rcl_interfaces.msg", "install what it needs for Python"),
    ],
)
def test_the_remedy_fits_the_python(monkeypatch: pytest.MonkeyPatch, python: str, module: str, remedy: str) -> None:
    monkeypatch.setattr(sys, "executable", python)
    assert remedy in missing.text(ModuleNotFoundError("No module named it", name=module))


def test_a_module_of_failstops_own_that_fails_is_a_defect() -> None:
    with pytest.raises(ImportError, match="no such name"):
        missing.say(ImportError("no such name", name="failstop.api.robot"))


@pytest.mark.starts
@pytest.mark.parametrize("own", [False, True])
def test_the_unit_takes_the_newest_ros_or_a_workspace_on_top_of_it(tmp_path: Path, own: bool) -> None:
    unit = (ROOT / "systemd/failstop-ros2@.service").read_text()
    (line,) = re.findall(r"^ExecStart=/bin/sh -c '(.+)' sh ", unit, re.MULTILINE)
    for name in ("opt/humble", "opt/jazzy", "workspace"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "setup.sh").write_text(f"ROS={name}\n")
    script = line.replace("$$", "$").replace("/opt/ros/", f"{tmp_path}/opt/").replace('exec "$@"', 'echo "$ROS"')
    environment = {"FAILSTOP_ROS_SETUP": f"{tmp_path}/workspace/setup.sh"} if own else {}
    done = subprocess.run(["/bin/sh", "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ("workspace" if own else "opt/jazzy")


def test_systemd_does_not_start_it_again() -> None:
    unit = (ROOT / "systemd/failstop-ros2@.service").read_text()
    assert f"\nRestartPreventExitStatus={INCOMPLETE}\n" in unit


@pytest.fixture
def launch(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The launch file as a module; what it imports of ROS keeps the words that it was made with."""

    def part(**words: Any) -> types.SimpleNamespace:
        return types.SimpleNamespace(**words)

    class Argument(str):
        """LaunchConfiguration: its value is that of the context, here a dict."""

        def perform(self, context: dict[str, str]) -> str:
            return context[self]

    names = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "EmitEvent", "OpaqueFunction"),
        "launch.conditions": ("IfCondition",),
        "launch.events": (),
        "launch.events.process": ("ProcessExited", "ShutdownProcess"),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for module, attributes in names.items():
        made = types.ModuleType(module)
        for attribute in attributes:
            setattr(made, attribute, lambda *names, **words: part(names=names, **words))
        if module == "launch.substitutions":
            made.LaunchConfiguration = Argument  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module, made)
    spec = importlib.util.spec_from_file_location("failstop_launch", LAUNCH)
    assert spec
    assert spec.loader
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def started(launch: Any, **given: str) -> list[Any]:
    """What it starts with these arguments."""
    (entities,) = launch.generate_launch_description().names
    declared = {entity.names[0]: entity.default_value for entity in entities[:-1]}
    assert set(given) <= set(declared)
    found: list[Any] = entities[-1].function(declared | given)
    return found


def test_launch_gives_the_bridge_a_file_of_parameters_and_what_is_typed(launch: Any) -> None:
    plain, laser, imu = started(launch)
    assert (plain.parameters, plain.name) == ([], "node")
    assert [words[-3:] for words in (laser.arguments, imu.arguments)] == [
        ["base_link", "--child-frame-id", "laser"],
        ["base_link", "--child-frame-id", "imu_link"],
    ]
    bridge, _, imu = started(
        launch, params_file="mine.yaml", publish_tf="true", base_frame_id="base", imu_frame_id="gyro"
    )
    assert bridge.parameters == [
        "mine.yaml",
        {name: name for name in ("publish_tf", "base_frame_id", "imu_frame_id")},
    ], "an argument wins over the file, and one that is not given leaves the file's"
    assert imu.arguments[-3:] == ["base", "--child-frame-id", "gyro"]


def test_the_file_to_copy_and_the_launch_file_have_the_parameters_of_the_bridge(launch: Any) -> None:
    declared = {row.name: row.default for row in SETTINGS}
    assert set(launch.PARAMETERS) == set(declared)
    text = (LAUNCH.parents[1] / "config/bridge.yaml").read_text()
    lines = re.findall(r"^    (# )?(\w+): (.+)$", text, re.MULTILINE)
    assert {name for _, name, _ in lines} == set(declared)
    # ROS can't tell of what type an empty list is, so the bridge's default has one empty name.
    words = {True: "true", False: "false", "['']": "[]"}
    defaults = {
        name: words.get(value if isinstance(value, bool) else str(value), str(value))
        for name, value in declared.items()
    }
    assert {name: default for name, (default, _) in launch.PARAMETERS.items()} == defaults
    assert {name: value for commented, name, value in lines if not commented}.items() <= defaults.items()


def test_launch_does_not_start_it_again(launch: Any) -> None:
    """`respawn` knows no exit codes; a process that is told to end while it waits for its turn is not started."""
    bridge, other = object(), object()
    assert launch._ended(types.SimpleNamespace(returncode=1, action=bridge), None) is None
    assert launch._ended(types.SimpleNamespace(returncode=-9, action=bridge), None) is None
    matches = launch._ended(types.SimpleNamespace(returncode=INCOMPLETE, action=bridge), None).event.process_matcher
    assert matches(bridge)
    assert not matches(other)

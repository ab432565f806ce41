"""The robot's publisher and the bridge to ROS 2, as doctor sees them."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.api.snapshot import Client
from failstop.doctor.look import OK, WARN
from failstop.doctor.system import System
from failstop.fleet import check as fleet
from failstop.fleet.settings import UNIT
from failstop.ros2 import check as ros2
from tests.doctor.parts import NOBODY, look, serving

INSTALLED = {"LoadState": "loaded", "ActiveState": "inactive", "UnitFileState": "disabled", "StatusErrno": "0"}
RUNS = {**INSTALLED, "ActiveState": "active", "UnitFileState": "enabled"}
DOWN = f"{UNIT} is enabled and failed: the robot obeys no stop of the fleet"
TWIN = {**RUNS, "StatusText": "obeys a fleet stop, but another publisher also calls itself r1", "StatusErrno": "76"}
DEAF = {**RUNS, "StatusText": "obeys no fleet stop: no key", "StatusErrno": "107"}


@pytest.mark.parametrize(
    ("unit", "level", "text", "fix"),
    [
        (None, OK, "the robot is in no fleet", ""),
        ({"LoadState": "not-found"}, OK, "the robot is in no fleet", ""),
        (INSTALLED, OK, "the robot is in no fleet", ""),
        ({**RUNS, "StatusText": "obeys a fleet stop"}, OK, "the robot obeys a fleet stop", ""),
        (TWIN, WARN, f"the robot {TWIN['StatusText']}", f"journalctl -u {UNIT}"),
        (DEAF, WARN, "the robot obeys no fleet stop: no key", f"journalctl -u {UNIT}"),
        ({**RUNS, "ActiveState": "failed"}, WARN, DOWN, f"journalctl -xeu {UNIT}"),
    ],
)
def test_what_the_publisher_says_of_itself(unit: dict[str, str] | None, level: str, text: str, fix: str) -> None:
    said = None if unit is None else "".join(f"{key}={value}\n" for key, value in unit.items())
    [found] = fleet.check(look(says={"systemctl": said}))
    assert (found.level, found.text, found.fix) == (level, text, fix)


ME = System().owner("/proc/self")
HERE = "the bridge to ROS 2 is connected"


@pytest.mark.parametrize(
    ("pid", "environment", "says"),
    [
        (0, "", "no bridge to ROS 2 is connected"),
        (7, "HOME=/\0FASTRTPS_DEFAULT_PROFILES_FILE=/own.xml\0", f"{HERE} (pid 7, user {ME})"),
        (7, "HOME=/\0", f"{HERE} (pid 7, user {ME}), by UDP alone"),
        (8, "", f"{HERE} (pid 8, user ), by UDP alone"),
    ],
    ids=["none", "own profile", "UDP", "gone meanwhile"],
)
def test_what_is_seen_of_it(tmp_path: Path, pid: int, environment: str, says: str) -> None:
    (tmp_path / "dev/shm").mkdir(parents=True)
    for name in ("fastrtps_1a", "fastrtps_port7411_el", "failstop.failstop.gate"):
        (tmp_path / "dev/shm" / name).touch()
    process = tmp_path / "proc/7"
    process.mkdir(parents=True)
    (process / "environ").write_text(environment)
    found = look(service=serving(clients=(Client(0, "ros2", pid, False),)) if pid else NOBODY)
    found.system = System(str(tmp_path))
    assert [row.text for row in ros2.check(found)] == [says]

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
DOWN = f"{UNIT} is enabled but failed, so the robot obeys no fleet stop"
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
    [found] = fleet.check(look(says={"systemctl": said}, booted=False))
    assert (found.level, found.text, found.fix) == (level, text, fix)


ME = System().owner("/proc/self")
HERE = "the bridge to ROS 2 is connected"


SHARED = "7f1c2000-7f1c3000 rw-s 00000000 00:1a 42   /dev/shm/{}"
LIBRARY = "7f1c0000-7f1c1000 r-xp 00000000 08:01 7    /opt/ros/jazzy/lib/libfastrtps.so.2.14"
UNREADABLE = "; its memory maps can't be read, so nobody knows whether it uses shared memory"


@pytest.mark.parametrize(
    ("pid", "maps", "says"),
    [
        (0, "", "no bridge to ROS 2 is connected"),
        (7, SHARED.format("fastrtps_1a2b"), f"{HERE} (pid 7, user {ME}), by Fast DDS's shared memory"),
        (7, SHARED.format("fastdds_port7411"), f"{HERE} (pid 7, user {ME}), by Fast DDS's shared memory"),
        (7, SHARED.format("fastrtps_1a2b (deleted)"), f"{HERE} (pid 7, user {ME}), by Fast DDS's shared memory"),
        (7, LIBRARY, f"{HERE} (pid 7, user {ME}), without Fast DDS's shared memory"),
        (7, SHARED.format("failstop.failstop.gate"), f"{HERE} (pid 7, user {ME}), without Fast DDS's shared memory"),
        (7, "", f"{HERE} (pid 7, user {ME}){UNREADABLE}"),
        (8, "", f"{HERE} (pid 8){UNREADABLE}"),
    ],
    ids=[
        "none",
        "Fast DDS 2",
        "Fast DDS 3",
        "its file is gone",
        "UDP",
        "failstop's own",
        "not allowed",
        "gone meanwhile",
    ],
)
def test_what_is_seen_of_it(tmp_path: Path, pid: int, maps: str, says: str) -> None:
    """By what the bridge has mapped, whatever its environment asked for."""
    (tmp_path / "dev/shm").mkdir(parents=True)
    for name in ("fastrtps_1a", "fastrtps_port7411_el", "failstop.failstop.gate"):
        (tmp_path / "dev/shm" / name).touch()
    process = tmp_path / "proc/7"
    process.mkdir(parents=True)
    (process / "environ").write_text("ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST\0")
    (process / "maps").write_text(maps)
    found = look(service=serving(clients=(Client(0, "ros2", pid, False),)) if pid else NOBODY)
    found.system = System(str(tmp_path))
    assert [row.text for row in ros2.check(found)] == [says]

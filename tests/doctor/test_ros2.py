"""The bridge to ROS 2 as doctor sees it, in a made-up tree of the system's files."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.api.snapshot import Client
from failstop.doctor.system import System
from failstop.ros2.check import check
from tests.doctor.parts import NOBODY, look, serving

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
    assert [row.text for row in check(found)] == [says]

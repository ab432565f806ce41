"""The bridge to ROS 2 as doctor sees it, in a made-up tree of the system's files."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.api.snapshot import Client
from failstop.doctor import service
from failstop.doctor.system import System, user
from tests.doctor.parts import look, serving

ME = user(os.getuid()).name


@pytest.mark.parametrize(
    ("pid", "environment", "says"),
    [
        (0, "", f"ROS 2 nodes of {ME} run here (or have left files), and no bridge is connected"),
        (7, "HOME=/\0FASTRTPS_DEFAULT_PROFILES_FILE=/own.xml\0", f"the bridge is connected (pid 7, user {ME})"),
        (7, "HOME=/\0", f"the bridge is connected (pid 7, user {ME}), by UDP alone"),
        (8, "", "the bridge is connected (pid 8, user ), by UDP alone"),
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
    found = look(service=serving(clients=(Client(0, "ros2", pid, False),)) if pid else None)
    found.system = System(str(tmp_path))
    assert [row.text for row in service.bridge(found)] == [says]

"""The bridge to ROS 2 as doctor sees it."""

from __future__ import annotations

import os
from pathlib import Path

from failstop.api.snapshot import Client
from failstop.doctor import judge_ros2, ros2_facts
from failstop.doctor.facts import Ros2
from failstop.doctor.system import System, user_name
from tests.doctor.parts import facts, serving


def bridge(pid: int) -> Client:
    return Client(0, "ros2", pid, False)


ME = user_name(os.getuid())


def test_facts(tmp_path: Path) -> None:
    for name in ("fastrtps_1a", "fastrtps_port7411_el", "failstop.failstop.gate"):
        (tmp_path / "dev/shm").mkdir(parents=True, exist_ok=True)
        (tmp_path / "dev/shm" / name).touch()
    process = tmp_path / "proc/7"
    process.mkdir(parents=True)
    (process / "environ").write_bytes(b"HOME=/\0FASTRTPS_DEFAULT_PROFILES_FILE=/own.xml\0")
    system = System(str(tmp_path))
    assert ros2_facts.ros2(None, system) == Ros2((ME,))
    assert ros2_facts.ros2(serving(clients=(bridge(7),)), system) == Ros2((ME,), 7, ME, True)
    (process / "environ").write_bytes(b"HOME=/\0")
    assert not ros2_facts.ros2(serving(clients=(bridge(7),)), system).own_profile
    assert ros2_facts.ros2(serving(clients=(bridge(8),)), system) == Ros2((ME,), 8), "it has gone meanwhile"
    assert ros2_facts.ros2(None, System(str(tmp_path / "nothing"))) == Ros2()


def test_a_bridge_of_another_user_is_a_problem_with_a_profile_of_its_own_alone() -> None:
    found = judge_ros2.bridge(facts(ros2=Ros2(("anna", "bob"), 7, "bob")))
    assert [(row.level, row.text) for row in found] == [
        ("ok", "the bridge is connected (pid 7, user bob), by UDP alone")
    ]
    assert judge_ros2.bridge(facts(ros2=Ros2(("anna", "bob"), 7, "bob", True)))[0].level == "warn"
    assert judge_ros2.bridge(facts(ros2=Ros2(("bob",), 7, "bob", True)))[0].level == "ok"

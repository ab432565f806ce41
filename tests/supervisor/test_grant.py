"""The one command that grants the rights, where the service runs, and the leases of a service without them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages.layout import GATE
from failstop.policy.processes import HANG_NS, PROCESS_BY_NAME, PROCESSES, SUPERVISOR_PRIORITY
from failstop.policy.settings import BY_KEY, Settings
from failstop.shm.heartbeat import EARLY_NEWS, REALTIME
from failstop.supervisor import status
from tests.support.supervisor_scene import Scene


@pytest.fixture
def here(scene: Scene) -> Any:
    """The module, as a service on the machine has it."""
    return scene.load("failstop.supervisor.status")


@pytest.mark.parametrize(
    ("unit", "container", "told"),
    [
        ("", False, "`sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited`"),
        ("", True, "`--cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=40 --ulimit memlock=-1`"),
        ("failstop.service", False, "`sudo systemctl edit failstop.service`, with LimitRTPRIO=40 and LimitMEMLOCK="),
        ("failstop@left.service", True, "`sudo systemctl edit failstop@left.service`"),
    ],
)
def test_the_command_fits_the_case(scene: Scene, here: Any, unit: str, container: bool, told: str) -> None:
    scene.write(status.CONTROL_GROUP, f"0::/system.slice/{unit}\n")
    if container:
        scene.me.environ[status.CONTAINER_VARIABLE] = "podman"
    assert told in here.advice(realtime=False, managed=bool(unit))
    assert "give it" not in here.advice(realtime=True, managed=bool(unit))


@pytest.mark.parametrize(
    ("managed", "container", "told"),
    [
        (True, False, "`sudo systemctl edit robot.service`, with ExecStartPre="),
        (False, False, "`sudo sh -c 'echo 950000 > /sys/fs/cgroup/cpu/system.slice/robot.service/cpu.rt_runtime_us'`"),
        (False, True, "`--cpu-rt-runtime=950000`"),
    ],
)
def test_where_the_limits_allow_it_the_command_is_for_the_control_group(
    scene: Scene, here: Any, managed: bool, container: bool, told: str
) -> None:
    """A person's shell may run in a unit too, but that unit did not start the service."""
    scene.write("/proc/self/limits", "Max realtime priority     99                   99\n")
    scene.write(status.CONTROL_GROUP, "4:cpu:/system.slice/robot.service\n")
    scene.write("/sys/fs/cgroup/cpu/system.slice/robot.service/cpu.rt_runtime_us", "0\n")
    if container:
        scene.me.environ[status.CONTAINER_VARIABLE] = "podman"
    assert told in here.advice(realtime=False, managed=managed)


def test_each_command_is_one_line() -> None:
    assert "\n" not in "".join((status.UNIT, status.CONTAINER, status.SHELL, status.GRANTED))


@pytest.mark.parametrize("sign", ["/.dockerenv", "/run/.containerenv", "variable", ""])
def test_a_container_is_known_by_its_signs(scene: Scene, here: Any, sign: str) -> None:
    if sign == "variable":
        scene.me.environ[status.CONTAINER_VARIABLE] = "podman"
    elif sign:
        scene.write(sign, "")
    assert here.in_container() is bool(sign)


@pytest.mark.parametrize(
    ("groups", "unit"),
    [
        ("0::/system.slice/failstop.service\n", "failstop.service"),
        ("12:cpu:/\n1:name=systemd:/system.slice/failstop@left.service\n", "failstop@left.service"),
        ("1:cpu:/\n0::/user.slice/user-1000.slice/user@1000.service/app.slice/robot.service\n", "robot.service"),
        ("0::/\n", "UNIT"),
    ],
)
def test_the_unit_is_that_of_the_control_group(scene: Scene, here: Any, groups: str, unit: str) -> None:
    assert here.own_unit() == "UNIT"
    scene.write(status.CONTROL_GROUP, groups)
    assert here.own_unit() == unit


def test_a_control_group_whose_name_is_no_text_hides_no_unit(here: Any, tmp_path: Path) -> None:
    """The kernel's own, read as a file of the real machine."""
    groups = tmp_path / "cgroup"
    groups.write_bytes(b"1:cpu:/\xff\n0::/system.slice/failstop.service\n")
    here.open = lambda path, **how: groups.open(**how)
    assert here.own_unit() == "failstop.service"


def test_people_are_told_what_is_lacking() -> None:
    realtime = ("SCHED_FIFO", f"{status.NO_REALTIME}, and {status.cost(0.2)}; give it rights")
    early_news = ("robust futexes", status.NO_EARLY_NEWS)
    assert status.lacking(0, "give it rights", 0.2) == [realtime, early_news]
    assert status.lacking(REALTIME, "give it rights", 0.2) == [early_news]
    assert status.lacking(EARLY_NEWS, "give it rights", 0.2) == [realtime]
    assert status.lacking(REALTIME | EARLY_NEWS, "give it rights", 0.2) == []


def test_a_lease_is_told_with_what_it_costs() -> None:
    late = "after 200 ms instead of 60 to 100 (gate.lease_s)"
    assert status.cost(0.2) == f"when the gate, supervisor or port owner hangs, the robot stops {late}"
    assert status.cost(1.5).endswith("the robot stops after 1500 ms instead of 60 to 100 (gate.lease_s)")
    assert status.cost(0.06) == "some stops will have no other reason, because gate.lease_s is as short as 60 ms"
    assert status.cost(0.05946).endswith(" as short as 59 ms")


def leased(scene: Scene, chosen: dict[str, object]) -> float:
    """The lease of a service that is started with these settings."""
    settings = scene.load("failstop.policy.settings").Settings(dict(chosen))
    found: float = scene.load("failstop.supervisor.status").leased(settings, chosen)[status.LEASE]
    return found


def test_the_lease_is_the_default_with_the_rights_of_every_process() -> None:
    scene = Scene(granted=REALTIME)
    asked: list[int] = []
    scene.refuse("sched_setscheduler", OSError(), lambda priority: bool(asked.append(priority)))
    assert leased(scene, {}) == status.LEASE_S
    assert asked == [max(SUPERVISOR_PRIORITY, *(row.priority for row in PROCESSES))]


@pytest.mark.parametrize(
    ("chosen", "lease_s"),
    [
        ({}, 0.2),
        ({"limits.vx_mps": 0.1}, 0.2),
        ({"gate.lease_s": 0.06}, 0.06),
        ({"gate.lease_s": 0.1, "sources.fast.timeout_s": 0.2, "sources.fast.priority": 1}, 0.1),
        ({"gate.command_timeout_s": 2.0}, 0.2),
        ({"gate.command_timeout_s": 0.2}, 0.18),
        ({"sources.fast.timeout_s": 0.1, "sources.fast.priority": 1}, 0.09),
        ({"gate.command_timeout_s": 0.061}, 0.06),
    ],
)
def test_the_lease_is_long_without_rights_unless_somebody_chose_one(
    scene: Scene, chosen: dict[str, object], lease_s: float
) -> None:
    assert leased(scene, chosen) == pytest.approx(lease_s)


def test_the_lease_without_rights_changes_nothing_of_who_stops_first() -> None:
    others_s = [HANG_NS / 1e9, PROCESS_BY_NAME[GATE].deadline_ns / 1e9]
    assert all(Settings().ns(status.LEASE) / 1e9 <= status.LEASE_WITHOUT_S < other_s for other_s in others_s)


ONCE = Scene()


@given(st.floats(0.0601, 2.0), st.floats(0.0601, 2.0), st.floats(0.005, 0.05))
def test_no_rights_never_make_settings_wrong_that_were_right(
    command_s: float, source_s: float, period_s: float
) -> None:
    timeouts = {"gate.command_timeout_s": command_s, "sources.cmd_vel.timeout_s": source_s}
    lease_s = leased(ONCE, {**timeouts, "gate.period_s": period_s})
    assert status.LEASE_S <= lease_s < min(command_s, source_s)


def test_the_meaning_of_the_setting_names_the_lease_without_rights() -> None:
    assert f"up to {status.LEASE_WITHOUT_S:g} s without real-time rights" in BY_KEY[status.LEASE].doc

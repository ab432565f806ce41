"""Real-time rights that are granted and refused all the same: by the control group, by a filter of system calls."""

from __future__ import annotations

import locale
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.policy.processes import SUPERVISOR_PRIORITY
from failstop.supervisor import refused

LIMITS = "Limit                     Soft Limit           Hard Limit\nMax realtime priority     {0}   {1}\n"
ALL, NONE = "000001ffffffffff", "0000000000000000"
FIRST, CONTAINED = "         0          0 4294967295\n", "         0     100000      65536\n"


class Machine:
    """The files of a process and of its control groups."""

    def __init__(self, at: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._at = at
        for name in ("PROC", "GROUP_FOLDER", "BOOT"):
            (at / name).mkdir()
            monkeypatch.setattr(refused, name, str(at / name))
        self.process()

    def write(self, where: str, path: str, text: str) -> Path:
        file = self._at / where / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    def process(self, rtprio: str = "0", caps: str = ALL, users: str = FIRST, *, hard: str = "0") -> None:
        self.write("PROC", "7/limits", LIMITS.format(rtprio, hard))
        self.write("PROC", "7/status", f"Name:\tfs\nCapEff:\t{caps}\n")
        self.write("PROC", "7/uid_map", users)

    def v1(self, group: str, *runtimes: str) -> None:
        """In this group of cgroup v1, whose groups from the top have these times."""
        self.write("PROC", "7/cgroup", f"9:name=systemd:/\n4:cpu,cpuacct:{group}\n0::/\n")
        parts = group.strip("/").split("/")
        for at, runtime in enumerate(runtimes):
            self.write("GROUP_FOLDER", "/".join(("cpu", *parts[: at + 1], refused.RUNTIME)), f"{runtime}\n")

    def v2(self, group: str, controllers: str = "cpu memory", config: str = "y") -> Path:
        """In this group of cgroup v2, on a kernel with this configuration, whose file is returned."""
        self.write("PROC", "7/cgroup", f"0::{group}\n")
        self.write("GROUP_FOLDER", f"{group.strip('/')}/cgroup.controllers", f"{controllers}\n")
        return self.write("BOOT", f"config-{os.uname().release}", f"CONFIG_X=y\n{refused.OPTION}{config}\n")


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("rtprio", "caps", "users", "allowed"),
    [
        ("0", NONE, FIRST, False),
        ("39", NONE, FIRST, False),
        ("40", NONE, FIRST, True),
        ("unlimited", NONE, CONTAINED, True),
        ("0", ALL, FIRST, True),
        ("0", "0000000000800000", FIRST, True),
        ("0", "000001ffff7fffff", FIRST, False),
        ("0", ALL, CONTAINED, False),
    ],
)
def test_what_is_not_granted_is_another_s_advice(
    machine: Machine, rtprio: str, caps: str, users: str, allowed: bool
) -> None:
    machine.v1("/robot", "0")
    machine.process(rtprio, caps, users)
    assert bool(refused.advice_if_allowed("7", priority=40)) is allowed


def test_the_soft_limit_counts_and_the_supervisor_s_priority_where_none_is_named(machine: Machine) -> None:
    machine.v1("/robot", "0")
    for soft, allowed in ((SUPERVISOR_PRIORITY - 1, False), (SUPERVISOR_PRIORITY, True)):
        machine.process(str(soft), NONE, hard="99")
        assert bool(refused.advice_if_allowed("7")) is allowed
    machine.process(str(SUPERVISOR_PRIORITY - 1), NONE)
    assert refused.advice_if_allowed("7", priority=SUPERVISOR_PRIORITY - 1) != ""


def test_on_cgroup_v1_each_group_from_the_top_gets_time(machine: Machine, tmp_path: Path) -> None:
    machine.v1("/system.slice/failstop.service", "0", "0")
    cpu = tmp_path / "GROUP_FOLDER" / "cpu"
    said = refused.advice_if_allowed("7")
    writes = (
        f"echo 950000 > {cpu}/system.slice/cpu.rt_runtime_us; "
        f"echo 950000 > {cpu}/system.slice/failstop.service/cpu.rt_runtime_us"
    )
    assert "(RT_GROUP_SCHED)" in said
    assert f"`sudo sh -c '{writes}'`, then start it again in the same shell" in said
    unit = refused.advice_if_allowed("7", unit="failstop.service")
    assert f"`sudo systemctl edit failstop.service`, with ExecStartPre=+/bin/sh -c '{writes}' under" in unit
    assert "--cpu-rt-runtime=950000" in refused.advice_if_allowed("7", container=True)
    assert refused.advice_if_allowed("7", unit="failstop.service", container=True) == unit, "it has systemd of its own"
    machine.v1("/system.slice/failstop.service", "950000", "0")
    assert "system.slice/cpu.rt_runtime_us" not in refused.advice_if_allowed("7"), "it has some"
    machine.v1("/system.slice/failstop.service", "950000", "950000")
    assert refused.advice_if_allowed("7") == refused.FILTER


def test_the_root_group_of_cgroup_v1_has_its_time_in_the_controller_s_folder(machine: Machine, tmp_path: Path) -> None:
    machine.v1("/", "0")
    said = refused.advice_if_allowed("7")
    assert f"`sudo sh -c 'echo 950000 > {tmp_path}/GROUP_FOLDER/cpu/cpu.rt_runtime_us'`" in said


def test_a_kernel_that_does_not_say_how_it_was_built_may_have_the_option(machine: Machine) -> None:
    machine.v2("/robot").unlink()
    assert refused.advice_if_allowed("7") == refused.V2


@pytest.mark.parametrize(
    ("group", "controllers", "config", "told"),
    [
        ("/system.slice/failstop.service", "cpu memory", "y", refused.V2),
        ("/system.slice/robot:left.service", "cpu memory", "y", refused.V2),
        ("/system.slice/failstop.service", "cpu memory", "n", refused.FILTER),
        ("/system.slice/failstop.service", "cpuset memory", "y", refused.FILTER),
        ("/", "cpu memory", "y", refused.FILTER),
    ],
)
def test_on_cgroup_v2_no_group_can_have_any(
    machine: Machine, group: str, controllers: str, config: str, told: str
) -> None:
    machine.v2(group, controllers, config)
    assert refused.advice_if_allowed("7") == told


def test_a_group_is_found_by_its_name_in_every_locale(machine: Machine) -> None:
    machine.v1("/r\u00f6bot", "0")
    before = locale.setlocale(locale.LC_CTYPE)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        said = refused.advice_if_allowed("7")
    finally:
        locale.setlocale(locale.LC_CTYPE, before)
    assert "/r\u00f6bot/cpu.rt_runtime_us" in said


def test_another_controller_s_group_whose_name_is_no_text_hides_nothing(machine: Machine, tmp_path: Path) -> None:
    machine.v1("/robot", "0")
    groups = tmp_path / "PROC/7/cgroup"
    groups.write_bytes(b"10:pids:/\xff\n" + groups.read_bytes())
    assert "/robot/cpu.rt_runtime_us" in refused.advice_if_allowed("7")


def test_files_that_cannot_be_read_are_no_reason(machine: Machine) -> None:
    assert refused.advice_if_allowed("8") == ""
    machine.process("nonsense", "0")
    assert refused.advice_if_allowed("7") == ""
    machine.write("PROC", "7/status", "Name:\tfs\n")
    assert refused.advice_if_allowed("7") == ""


REAL = Path("/sys/fs/cgroup/cpu")
RUNS = """
import os, sys
from failstop.procs import rights
from failstop.supervisor import refused
with rights.realtime(40) as granted:
    print("granted" if granted else refused.advice_if_allowed())
"""


@pytest.mark.skipif(
    os.geteuid() != 0 or not (REAL / refused.RUNTIME).exists(), reason="needs root, and a kernel that schedules so"
)
@pytest.mark.starts
def test_a_group_of_this_kernel_refuses_and_the_command_that_is_told_helps() -> None:
    """Followed to the letter, but for sudo."""
    outer = REAL / f"failstop-test-{os.getpid()}"
    inner = outer / "inner"

    def join() -> None:
        (inner / "cgroup.procs").write_text(str(os.getpid()))

    def said() -> str:
        words = [sys.executable, "-c", RUNS]
        return subprocess.run(words, preexec_fn=join, capture_output=True, text=True, check=True).stdout

    outer.mkdir()
    inner.mkdir()
    try:
        found = re.search(r"`sudo sh -c '(.*?)'`", told := said())
        assert found, told
        subprocess.run(["sh", "-c", found[1]], check=True)
        assert said() == "granted\n"
    finally:
        inner.rmdir()
        outer.rmdir()

"""Gathering: from a made-up tree of the system's files, and from this machine."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.doctor import machine, port, service, stop_path, table
from failstop.doctor.look import Look
from failstop.doctor.system import Holder, System, User
from failstop.instances import unit_of
from failstop.shm import claim, layout, segment


def write(root: Path, path: str, text: str) -> None:
    place = root / path.lstrip("/")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)


def test_the_usb_device_is_found_above_its_node(tmp_path: Path) -> None:
    usb = "/sys/devices/pci0/usb1/1-2"
    write(tmp_path, f"{usb}/idVendor", "1a86\n")
    write(tmp_path, f"{usb}/idProduct", "55d4\n")
    write(tmp_path, f"{usb}/product", "USB Single Serial\n")
    (tmp_path / f"{usb}/1-2:1.0".lstrip("/")).mkdir()
    link = tmp_path / "sys/dev/char/166:0"
    link.mkdir(parents=True)
    (link / "device").symlink_to(tmp_path / f"{usb}/1-2:1.0".lstrip("/"))
    system = System(str(tmp_path))
    assert system.usb("/sys/dev/char/166:0") == ("1a86:55d4", "USB Single Serial", False)
    assert system.usb("/sys/dev/char/4:0") == ("", "", False)


@pytest.mark.parametrize(
    ("of_node", "of_device", "ignored"),
    [
        ("E:ID_MM_PORT_IGNORE=1\n", None, True),
        ("E:ID_MM_CANDIDATE=1\n", "E:ID_MM_DEVICE_IGNORE=1\n", True),
        ("E:ID_MM_DEVICE_IGNORE=1\n", None, True),
        ("E:ID_BUS=usb\n", "E:ID_MM_PORT_IGNORE=1\n", False),
        ("E:ID_BUS=usb\n", "E:ID_BUS=usb\n", False),
        (None, None, False),
    ],
)
def test_what_udev_tells_modem_manager(
    tmp_path: Path, of_node: str | None, of_device: str | None, ignored: bool
) -> None:
    usb, node = "/sys/devices/pci0/usb1/1-2", "/sys/dev/char/166:0"
    for name, text in (("idVendor", "1a86\n"), ("idProduct", "55d4\n"), ("dev", "189:1\n")):
        write(tmp_path, f"{usb}/{name}", text)
    write(tmp_path, f"{node}/dev", "166:0\n")
    (tmp_path / f"{node}/device".lstrip("/")).symlink_to(tmp_path / usb.lstrip("/"))
    for number, record in (("166:0", of_node), ("189:1", of_device)):
        if record is not None:
            write(tmp_path, f"/run/udev/data/c{number}", record)
    assert System(str(tmp_path)).usb(node) == ("1a86:55d4", "", ignored)


def test_processes_and_their_units(tmp_path: Path) -> None:
    write(tmp_path, "/proc/12/comm", "ModemManager\n")
    write(tmp_path, "/proc/12/cgroup", "0::/system.slice/ModemManager.service\n")
    write(tmp_path, "/proc/13/comm", "bash\n")
    system = System(str(tmp_path))
    write(tmp_path, "/proc/14/cmdline", "python\0/x/supervisor/child.py\0name=left\0")
    assert [system.holder(pid) for pid in system.pids()] == [
        Holder(12, "ModemManager", "ModemManager.service"),
        Holder(13, "bash"),
        Holder(14, "?", instance="left"),
    ]


CONF = "/systemd/logind.conf"


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ({}, (True, "")),
        ({f"/etc{CONF}": "[Login]\n#RemoveIPC=no\n"}, (True, "")),
        ({f"/etc{CONF}": "[Login]\nRemoveIPC=no\n"}, (False, f"/etc{CONF}")),
        (
            {f"/etc{CONF}": "RemoveIPC=no\n", f"/run{CONF}.d/a.conf": "RemoveIPC = yes\n"},
            (True, f"/run{CONF}.d/a.conf"),
        ),
        (
            {f"/usr/lib{CONF}.d/a.conf": "RemoveIPC=yes\n", f"/etc{CONF}.d/a.conf": "RemoveIPC=no\n"},
            (False, f"/etc{CONF}.d/a.conf"),
        ),
        ({f"/usr/lib{CONF}": "RemoveIPC=no\n", f"/etc{CONF}": "[Login]\n"}, (True, "")),
        (
            {f"/etc{CONF}.d/a.conf": "RemoveIPC=no\n", f"/usr/lib{CONF}.d/b.conf": "RemoveIPC=1\n"},
            (True, f"/usr/lib{CONF}.d/b.conf"),
        ),
    ],
)
@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="needs systemd-analyze, which shows logind's files")
def test_remove_ipc_as_logind_reads_it(tmp_path: Path, files: dict[str, str], found: tuple[bool, str]) -> None:
    for path, text in files.items():
        write(tmp_path, path, text)
    on, path = service.logind_removes(System(str(tmp_path)))
    assert (on, path.removeprefix(str(tmp_path))) == found


def test_governors_and_the_slowest_state_in_use(tmp_path: Path) -> None:
    folder = "/sys/devices/system/cpu"
    for core, governor in (("cpu0", "powersave"), ("cpu1", "performance")):
        write(tmp_path, f"{folder}/{core}/cpufreq/scaling_governor", governor)
    for state, name, latency, disabled in (("state0", "C1", 2, 0), ("state1", "C6", 85, 0), ("state2", "C10", 890, 1)):
        for key, value in (("name", name), ("latency", latency), ("disable", disabled)):
            write(tmp_path, f"{folder}/cpu0/cpuidle/{state}/{key}", f"{value}\n")
    (tmp_path / "sys/devices/system/cpu/cpufreq").mkdir()
    look = Look(system=System(str(tmp_path)))
    assert "CPU governor powersave" in machine.processor(look)[0].text
    assert machine.idle(look)[0].text == "the slowest idle state C6 takes 85 us to wake from"


def test_units_by_name() -> None:
    assert unit_of("failstop") == "failstop.service"
    assert unit_of("left") == "failstop@left.service"


SYSTEMCTL = """#!/bin/sh
test "$1 $2" = "show failstop@left.service" && echo LoadState=loaded && echo MainPID=12
"""
TOLD = {"LoadState": "loaded", "MainPID": "12"}


@pytest.mark.parametrize(
    ("script", "found"),
    [(SYSTEMCTL, TOLD), ("#!/bin/sh\nexit 1\n", {}), ("#!/bin/sh\nexec sleep 30\n", {}), ("", {})],
    ids=["answers", "fails", "hangs", "missing"],
)
def test_systemctl_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, found: dict[str, str]
) -> None:
    if script:
        write(tmp_path, "bin/systemctl", script)
        (tmp_path / "bin/systemctl").chmod(0o755)
    shell_tools = "" if not script else ":/usr/bin:/bin"
    monkeypatch.setenv("PATH", f"{tmp_path}/bin{shell_tools}")
    look = Look("left")
    vars(look)["systemd"] = True
    assert look.unit == found


@pytest.fixture
def dead_run() -> Iterator[str]:
    name = f"dead-{os.getpid()}"
    for spec in layout.SEGMENTS:
        segment.create(segment.memory(name, 7), spec.name, 7).close()
    yield name
    segment.unlink_all(segment.memory(name, 7))


def test_the_shared_memory_of_a_dead_run(dead_run: str) -> None:
    [found] = machine.left(Look(dead_run))
    assert found.text == "the last run was killed; the next start keeps what it recorded as an incident"


@pytest.mark.parametrize(("locked", "found"), [(7, 8), (8, 7)])
def test_what_lives_is_no_dead_run(tmp_path: Path, locked: int, found: int) -> None:
    for file in ("failstop.$(id).gate", "failstop.7.supervisor", "failstop.8.supervisor", "other.7.supervisor"):
        write(tmp_path, f"/dev/shm/failstop.{file}", "")
    supervisor = os.open(tmp_path / f"dev/shm/failstop.failstop.{locked}.supervisor", os.O_RDWR)
    assert claim.take(supervisor, 0)
    look = Look(system=System(str(tmp_path)))
    vars(look)["service_user"] = User("stranger", os.geteuid() + 4711)
    [told] = machine.left(look)
    os.close(supervisor)
    assert told.fix == f"sudo rm /dev/shm/failstop.failstop.{found}.*"


def test_who_has_a_device_open_that_an_unplug_has_removed(tmp_path: Path) -> None:
    files = tmp_path / "proc" / "77" / "fd"
    files.mkdir(parents=True)
    (tmp_path / "proc" / "77" / "comm").write_text("minicom\n")
    (files / "3").symlink_to("/dev/ttyACM0 (deleted)")
    (files / "4").symlink_to("/dev/ttyACM1")
    [found] = port.held(Look(device_path="/nowhere", system=System(str(tmp_path))))
    assert found.text.startswith("minicom (pid 77) has /dev/ttyACM0 open from before an unplug")


def test_who_has_a_device_open() -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    code = f"import os; os.open({path!r}, os.O_RDWR | os.O_NOCTTY); print('open', flush=True); input()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "open\n"
            assert [holder.pid for holder in System().holders(path)[0]] == [other.pid]
        finally:
            other.kill()
    os.close(slave)
    assert System().holders(path)[0] == ()
    os.close(master)


def test_a_pseudo_terminal_is_told_from_a_board() -> None:
    master, slave = pty.openpty()
    found = System().node(os.ttyname(slave))
    assert found is not None
    assert (found.pseudo, found.accessible) == (True, True)
    assert System().node("/nowhere") is None
    os.close(slave)
    os.close(master)


def test_rights_and_room(tmp_path: Path) -> None:
    write(tmp_path, "/proc/self/status", "Name:\tpython3\nCapEff:\t0000000000804000\n")
    system = System(str(tmp_path))
    assert [capability for capability in range(64) if system.capable(capability)] == [14, 23]
    assert not System(str(tmp_path / "nothing")).capable(14)
    assert system.room("/nowhere") is None
    assert (system.room("/") or 0) > 0


def test_asking_for_real_time_leaves_no_trace() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    with System().realtime() as granted:
        assert granted == (os.sched_getscheduler(0) == os.SCHED_FIFO)
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_the_ticks_of_this_machine() -> None:
    found = System().ticks(0.3)
    assert [realtime for realtime, _ in found] == [False, True][: len(found)]
    for _, late_ns in found:
        assert 1 <= len(late_ns) <= 60
        assert min(late_ns) >= 0


def test_all_of_it_is_quick() -> None:
    begun_s = time.monotonic()
    look = Look(f"none-{os.getpid()}", device_path="/nowhere", quick=True)
    table.examine(look)
    assert time.monotonic() - begun_s < 10.0
    assert look.service is None
    assert [row.text for row in stop_path.stop_path(look)] == ["not tested: there is no port"]

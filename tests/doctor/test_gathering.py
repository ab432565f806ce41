"""Gathering: from a made-up tree of the system's files, and from this machine."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.doctor import device, leftovers, machine, port, service, stop_path, table, ticks
from failstop.doctor.look import Look, version_of
from failstop.doctor.system import System, User, user
from failstop.instances import unit_of
from failstop.lab.trial import Trial
from failstop.shm import claim, layout, segment
from failstop.version import VERSION


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
    assert device.usb_identity("/sys/dev/char/166:0/device", system) == ("1a86:55d4", "USB Single Serial")
    assert device.usb_identity("/sys/dev/char/4:0/device", system) == (None, "")


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
    assert device.modem_ignored(node, System(str(tmp_path))) is ignored


def test_processes_and_their_units(tmp_path: Path) -> None:
    write(tmp_path, "/proc/12/comm", "ModemManager\n")
    write(tmp_path, "/proc/12/cgroup", "0::/system.slice/ModemManager.service\n")
    write(tmp_path, "/proc/13/comm", "bash\n")
    system = System(str(tmp_path))
    assert [(pid, system.comm(pid), system.unit(pid)) for pid in system.pids()] == [
        (12, "ModemManager", "ModemManager.service"),
        (13, "bash", ""),
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
def test_remove_ipc_as_logind_reads_it(tmp_path: Path, files: dict[str, str], found: tuple[bool, str]) -> None:
    for path, text in files.items():
        write(tmp_path, path, text)
    assert service.logind_removes(System(str(tmp_path))) == found


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
    def left(server: User) -> leftovers.Leftover:
        return next(row for row in leftovers.look(server, System())[0] if row.instance == dead_run)

    assert left(user(os.geteuid())).ours
    assert left(user(os.geteuid())).size > 0
    assert version_of(dead_run) == VERSION
    assert not left(User("stranger", os.geteuid() + 4711)).ours


def test_what_dead_runs_left_is_removed_and_what_lives_is_not(dead_run: str, tmp_path: Path) -> None:
    """In a copy of the folder: others' runs are left alone."""
    for file in os.listdir("/dev/shm"):
        if file.startswith(f"failstop.{dead_run}."):
            write(tmp_path, f"/dev/shm/{file}", "")
    write(tmp_path, "/dev/shm/failstop.BAD!.x", "")
    write(tmp_path, "/dev/shm/other", "")
    with Trial(f"alive-{os.getpid()}") as trial:
        alive = [f"failstop.{trial.name}.7.{of}" for of in (layout.GATE, layout.SUPERVISOR)]
        for file in alive:
            write(tmp_path, f"/dev/shm/{file}", "")
        supervisor = os.open(tmp_path / "dev/shm" / alive[1], os.O_RDWR)
        assert claim.take(supervisor, 0)
        _, living = leftovers.look(user(os.geteuid()), System())
        assert trial.name in living
        removed, left = leftovers.remove(System(str(tmp_path)))
    assert [row.instance for row in removed] == [dead_run]
    assert left == []
    assert sorted(os.listdir(tmp_path / "dev/shm")) == ["failstop.BAD!.x", *alive, "other"]
    os.close(supervisor)


def test_who_has_a_device_open_that_an_unplug_has_removed(tmp_path: Path) -> None:
    files = tmp_path / "proc" / "77" / "fd"
    files.mkdir(parents=True)
    (tmp_path / "proc" / "77" / "comm").write_text("minicom\n")
    (files / "3").symlink_to("/dev/ttyACM0 (deleted)")
    (files / "4").symlink_to("/dev/ttyACM1")
    [found] = port.held(Look(device="/nowhere", system=System(str(tmp_path))))
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
            holders, _ = device.holders(path, {4711}, System())
            assert [(holder.pid, holder.ours) for holder in holders] == [(other.pid, False)]
            assert device.holders(path, {other.pid}, System())[0][0].ours
        finally:
            other.kill()
    os.close(slave)
    assert device.holders(path, set(), System())[0] == ()
    os.close(master)


def test_a_pseudo_terminal_is_told_from_a_board() -> None:
    master, slave = pty.openpty()
    found = device.node(os.ttyname(slave), System())
    assert found is not None
    assert (found.character, found.pseudo, found.accessible) == (True, True, True)
    assert device.node("/nowhere", System()) is None
    os.close(slave)
    os.close(master)


def test_the_clocks_of_this_machine() -> None:
    assert System().backward_ns() == 0
    assert 0 < System().resolution_ns() < 20_000_000


def test_rights_and_room(tmp_path: Path) -> None:
    write(tmp_path, "/proc/self/status", "Name:\tpython3\nCapEff:\t0000000000804000\n")
    system = System(str(tmp_path))
    assert [capability for capability in range(64) if system.capable(capability)] == [14, 23]
    assert not System(str(tmp_path / "nothing")).capable(14)
    assert (system.free("/nowhere"), system.writable("/nowhere")) == (None, False)
    assert (system.free("/") or 0) > 0
    assert system.writable("/")


def test_asking_for_real_time_leaves_no_trace() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    System().realtime()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_the_ticks_of_this_machine() -> None:
    found = ticks.measure(0.3)
    assert not found[0].realtime
    for row in found:
        assert 1 <= row.times <= 30
        assert 0 < row.median_us <= row.p99_us <= row.worst_us


def test_ticks_in_numbers() -> None:
    found = ticks.summary([n * 1000 for n in range(101)], realtime=True)
    assert (found.median_us, found.p99_us, found.worst_us, found.times) == (50.0, 99.0, 100.0, 101)


def test_all_of_it_is_quick() -> None:
    begun_s = time.monotonic()
    look = Look(f"none-{os.getpid()}", device="/nowhere", quick=True)
    table.examine(look)
    assert time.monotonic() - begun_s < 10.0
    assert look.service is None
    assert stop_path.tried(look).skipped == "there is no port"

"""Gathering: from a made-up tree of the system's files, and from this machine."""

from __future__ import annotations

import grp
import os
import pty
import pwd
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from failstop.board.rrc.board import BOARD
from failstop.doctor import machine, port, stop_path, table
from failstop.doctor.look import FAIL, OK, SKIP, Look
from failstop.doctor.system import Holder, System
from tests.doctor.parts import NOBODY, NODE, but, look
from tests.support.ptys import new_pty, open_fds


def write(root: Path, path: str, text: str) -> None:
    place = root / path.lstrip("/")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)


def test_processes_and_their_units(tmp_path: Path) -> None:
    write(tmp_path, "/proc/12/comm", "ModemManager\n")
    write(tmp_path, "/proc/12/cgroup", "0::/system.slice/ModemManager.service\n")
    write(tmp_path, "/proc/13/comm", "bash\n")
    system = System(str(tmp_path))
    write(tmp_path, "/proc/14/cmdline", "python\0/x/supervisor/bootstrap.py\0name=left\0")
    assert [system.holder(pid) for pid in (12, 13, 14)] == [
        Holder(12, "ModemManager", "ModemManager.service"),
        Holder(13, "bash"),
        Holder(14, "?", instance="left"),
    ]


def test_proc_hides_the_processes_of_others_if_the_first_one_is_not_seen(tmp_path: Path) -> None:
    """With hidepid=2 a user's /proc lists only the user's own processes."""
    write(tmp_path, "/proc/77/comm", "bash\n")
    assert System(str(tmp_path)).hides_processes()
    found = port.grabbers(Look(device_path="/nowhere", system=System(str(tmp_path))))
    assert [row.level for row in found] == [SKIP]
    write(tmp_path, "/proc/1/comm", "systemd\n")
    assert not System(str(tmp_path)).hides_processes()
    assert not System().hides_processes() or os.geteuid()


SUPERVISOR = "python\0/x/supervisor/bootstrap.py\0supervisor\0name=left\0lock=4\0"
GATE = "python\0/x/supervisor/bootstrap.py\0gate\0name=left\0parent=13\0"


@pytest.mark.parametrize(
    ("command", "cgroup", "who", "end"),
    [
        ("vim\0", "/user.slice/session-3.scope", "x (pid 14)", "sudo kill 14"),
        # A terminal of the desktop, and a unit of the user's own.
        ("vim\0", "/user.slice/user@1000.service/app.slice/term.scope", "x (pid 14)", "sudo kill 14"),
        ("vim\0", "/user@1000.service/a.service", "x (pid 14, a.service)", "systemctl --user stop a.service"),
        ("vim\0", "/system.slice/a.service", "x (pid 14, a.service)", "sudo systemctl stop a.service"),
        # The supervisor starts its gate again when that is killed.
        (GATE, "/", "the service 'left' (pid 13)", "sudo kill 13"),
        (SUPERVISOR, "/", "the service 'left' (pid 14)", "sudo kill 14"),
        (GATE, "/b.service", "the service 'left' (pid 13, b.service)", "sudo systemctl stop b.service"),
    ],
)
def test_who_has_a_port_and_the_command_that_ends_it(
    command: str, cgroup: str, who: str, end: str, tmp_path: Path
) -> None:
    write(tmp_path, "/proc/14/comm", "x\n")
    write(tmp_path, "/proc/14/cmdline", command)
    write(tmp_path, "/proc/14/cgroup", f"0::{cgroup}\n")
    holder = System(str(tmp_path)).holder(14)
    assert (str(holder), holder.end()) == (who, end)


def test_the_name_of_a_process_moves_no_cursor(tmp_path: Path) -> None:
    write(tmp_path, "/proc/14/comm", "a\x1b[2Jb\n")
    assert str(System(str(tmp_path)).holder(14)) == r"a\x1b[2Jb (pid 14)"


def test_who_may_write_a_folder_and_what_a_process_was_started_with(tmp_path: Path) -> None:
    system = System(str(tmp_path))
    folder, other = tmp_path / "state", 4711 if os.geteuid() != 4711 else 4712
    folder.mkdir(mode=0o755)
    assert [system.writable("/state", uid) for uid in (os.geteuid(), 0, other)] == [True, True, False]
    folder.chmod(0o777)
    assert system.writable("/state", other)
    write(tmp_path, "/file", "")
    assert [system.writable(path, os.geteuid()) for path in ("/nothing", "/file")] == [False, False]
    write(tmp_path, "/proc/12/environ", "HOME=/h\0STATE_DIRECTORY=/s=t\0")
    assert system.environ("12") == {"HOME": "/h", "STATE_DIRECTORY": "/s=t"}
    assert system.environ("13") is None
    assert (system.account("root"), system.account("nobody-of-this-name")) == (0, -1)


def test_what_keeps_a_user_from_a_file(tmp_path: Path) -> None:
    """The file itself, or a folder on the way to it, also behind a link."""
    system, other = System(str(tmp_path)), 4711 if os.geteuid() != 4711 else 4712
    tmp_path.chmod(0o755)
    write(tmp_path, "/home/robot/x.toml", "")
    home, file = tmp_path / "home/robot", tmp_path / "home/robot/x.toml"
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/x.toml").symlink_to("../home/robot/x.toml")
    (tmp_path / "whole.toml").symlink_to("/home/robot/x.toml")
    for mode, folder, found in (
        (0o644, 0o755, ""),
        (0o640, 0o755, "/home/robot/x.toml"),
        (0o644, 0o750, "/home/robot"),
    ):
        file.chmod(mode)
        home.chmod(folder)
        for path in ("/home/robot/x.toml", "/etc/x.toml", "/whole.toml", "/etc/../home/robot/x.toml"):
            assert [system.barrier(path, uid) for uid in (os.geteuid(), 0, other)] == ["", "", found], path
    assert system.barrier("/nothing", other) == ""
    assert system.through("/etc/x.toml") == ["/", "/etc", "/etc/x.toml", "/home", "/home/robot", "/home/robot/x.toml"]
    file.chmod(0o604)
    home.chmod(0o755)
    assert system.barrier("/etc/x.toml", other, 0o6) == "/home/robot/x.toml", "it may be read, and not written"
    (tmp_path / "turns").symlink_to("turns")
    assert system.barrier("/turns", other) == ""


@pytest.mark.parametrize(
    ("file", "folder", "exposed"),
    [
        (0o644, 0o755, ""),
        (0o646, 0o755, "/home/robot/x.toml"),
        (0o644, 0o757, "/home/robot"),
        (0o644, 0o1777, ""),
        (0o666, 0o1777, "/home/robot/x.toml"),
    ],
    ids=lambda mode: mode if isinstance(mode, str) else f"{mode:o}",
)
def test_what_lets_others_change_a_file(file: int, folder: int, exposed: str, tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    write(tmp_path, "/home/robot/x.toml", "")
    (tmp_path / "x.toml").symlink_to("home/robot/x.toml")
    (tmp_path / "home/robot/x.toml").chmod(file)
    (tmp_path / "home/robot").chmod(folder)
    assert System(str(tmp_path)).exposed("/x.toml") == exposed
    assert System(str(tmp_path)).exposed("/nothing") == ""


def test_a_group_that_has_only_the_owner_is_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path.chmod(0o755)
    write(tmp_path, "/x.toml", "")
    (tmp_path / "x.toml").chmod(0o664)
    found = os.stat(tmp_path / "x.toml")
    owner = SimpleNamespace(pw_name="anna", pw_gid=found.st_gid)
    monkeypatch.setattr(pwd, "getpwuid", lambda _: owner)
    monkeypatch.setattr(pwd, "getpwall", lambda: [owner])
    for members, exposed in (([], ""), (["anna"], ""), (["anna", "bob"], "/x.toml")):
        monkeypatch.setattr(grp, "getgrgid", lambda _, members=members: SimpleNamespace(gr_mem=members))
        assert System(str(tmp_path)).exposed("/x.toml") == exposed
    monkeypatch.setattr(grp, "getgrgid", lambda _: SimpleNamespace(gr_mem=[]))
    monkeypatch.setattr(pwd, "getpwall", lambda: [owner, SimpleNamespace(pw_name="bob", pw_gid=found.st_gid)])
    assert System(str(tmp_path)).exposed("/x.toml") == "/x.toml"


def test_setup_asks_whether_this_user_may_open_the_port() -> None:
    """Setup opens it itself, also if a unit is installed whose user may open it."""
    closed = look(node=but(NODE, accessible=False), service=NOBODY)
    assert [row.level for row in port.permission(closed)] == [OK]
    assert [row.level for row in port.accessible(closed)] == [FAIL]


def test_a_user_may_be_let_in_by_a_group_of_the_unit(tmp_path: Path) -> None:
    system, other = System(str(tmp_path)), 4711 if os.geteuid() != 4711 else 4712
    tmp_path.chmod(0o755)
    write(tmp_path, "/file", "")
    (tmp_path / "file").chmod(0o640)
    group = grp.getgrgid(os.stat(tmp_path / "file").st_gid).gr_name
    assert system.barrier("/file", other, 0o4, ("no-group-of-this-name",)) == "/file"
    assert system.barrier("/file", other, 0o4, (group,)) == ""


def test_the_governors_of_all_cores(tmp_path: Path) -> None:
    folder = "/sys/devices/system/cpu"
    for core, governor in (("cpu0", "powersave"), ("cpu1", "performance")):
        write(tmp_path, f"{folder}/{core}/cpufreq/scaling_governor", governor)
    (tmp_path / "sys/devices/system/cpu/cpufreq").mkdir()
    assert "CPU governor powersave:" in machine.processor(Look(system=System(str(tmp_path))))[0].text


def test_an_own_folder_that_can_not_be_used_is_told_and_its_port_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f'[board]\nkind = "{tmp_path}/tank"\n')
    look = Look("nobody-here", config_path=str(file), device_path="/dev/null")
    [found] = stop_path.board(look)
    assert found.level == "fail"
    assert f"{tmp_path}/tank: No such file or directory" in found.text
    [found] = stop_path.stop_path(look)
    assert found.text == "not tested: the settings that name the board can't be used"
    [found] = port.identity(look)
    assert found.text == f"no USB device; a board of the kind {tmp_path}/tank may be at any port"


def test_the_port_and_the_board_of_a_file_with_another_mistake_are_looked_at(tmp_path: Path) -> None:
    """The service uses both too, for its first stop."""
    file = tmp_path / "robot.toml"
    file.write_text('device.path = "/nowhere/b"\nboard.kind = "vesc"\nboard.baud = "fast"\nlimits.vx_mps = 9\n')
    look = Look("nobody-here", config_path=str(file))
    assert (look.device, look.kind) == (("/nowhere/b", str(file)), "vesc")
    assert "limits.vx_mps" in look.settings[-1] or "board.baud" in look.settings[-1]
    [found] = port.present(look)
    assert found.text.startswith(f"no device /nowhere/b ({file})")
    assert any("VESC" in found.text for found in port.commanders(look))
    file.write_text("half = ")
    assert Look("nobody-here", config_path=str(file)).device[1] == "the default"


SYSTEMCTL = """#!/bin/sh
test "$1 $2" = "show failstop@left.service" && echo LoadState=loaded && echo MainPID=12
"""
TOLD = {"LoadState": "loaded", "MainPID": "12"}


@pytest.mark.parametrize(
    ("script", "found"),
    [(SYSTEMCTL, TOLD), ("#!/bin/sh\nexit 1\n", {}), ("#!/bin/sh\nexec sleep 30\n", {}), ("", {})],
    ids=["answers", "fails", "hangs", "missing"],
)
def test_systemctl_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, found: object) -> None:
    if script:
        write(tmp_path, "bin/systemctl", script)
        (tmp_path / "bin/systemctl").chmod(0o755)
    shell_tools = "" if not script else ":/usr/bin:/bin"
    monkeypatch.setenv("PATH", f"{tmp_path}/bin{shell_tools}")
    given = Look("left", system=System(str(tmp_path)))
    assert given.unit == found
    assert not given.unit_unknown, "systemd is not running"
    (tmp_path / "run/systemd/system").mkdir(parents=True)
    assert given.unit_unknown == (not found)


def test_who_has_a_device_open_that_an_unplug_has_removed(tmp_path: Path) -> None:
    files = tmp_path / "proc" / "77" / "fd"
    files.mkdir(parents=True)
    (tmp_path / "proc" / "77" / "comm").write_text("minicom\n")
    (files / "3").symlink_to("/dev/ttyACM0 (deleted)")
    (files / "4").symlink_to("/dev/ttyACM1")
    [found] = port.held(Look(device_path="/nowhere", system=System(str(tmp_path))))
    assert found.text.startswith("minicom (pid 77) has /dev/ttyACM0 open since before it was unplugged")


@pytest.mark.parametrize("how", ["O_RDWR", "O_RDONLY"])
def test_who_has_a_device_open(how: str) -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    code = f"import os; os.open({path!r}, os.{how} | os.O_NOCTTY); print('open', flush=True); input()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "open\n"
            assert [holder.pid for holder in System().holders(path)[0]] == [other.pid]
            assert System().writes(other.pid, path) == (how == "O_RDWR")
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


def test_whether_udev_tells_modem_manager_to_leave_it_alone(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    path, number = os.ttyname(slave), os.fstat(slave).st_rdev
    for record, ignored in (("E:ID_BUS=usb\n", False), ("E:ID_BUS=usb\nE:ID_MM_PORT_IGNORE=1\n", True)):
        write(tmp_path, f"/run/udev/data/c{os.major(number)}:{os.minor(number)}", record)
        found = System(str(tmp_path)).node(path)
        assert found is not None
        assert found.modem_ignored == ignored
    os.close(slave)
    os.close(master)


def test_owners_and_room() -> None:
    system = System()
    assert system.room("/nowhere") is None
    assert (system.room("/") or 0) > 0
    assert (system.uid("/proc/1"), system.owner("/proc/1")) == (0, "root")
    assert (system.uid("/nowhere"), system.owner("/nowhere")) == (-1, "")


def test_asking_for_real_time_leaves_no_trace() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    with System().realtime() as granted:
        assert granted == (os.sched_getscheduler(0) == os.SCHED_FIFO)
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_the_ticks_of_this_machine() -> None:
    with System().realtime() as granted:
        pass
    realtime, late_ns = System().ticks(0.3)
    assert realtime == granted
    assert 1 <= len(late_ns) <= 60
    assert min(late_ns) >= 0


def test_all_of_it_is_looked_at_without_a_port() -> None:
    look = Look(f"none-{os.getpid()}", device_path="/nowhere", quick=True)
    table.examine(look)
    assert look.service == (None, "", "")
    assert [row.text for row in stop_path.stop_path(look)] == ["not tested: there is no port"]


def test_listing_puts_the_board_first(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [
        SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None, pid=None),
        SimpleNamespace(device="/dev/ttyUSB0", description="USB Serial", vid=0x1A86, pid=0x7523),
        SimpleNamespace(device="/dev/ttyACM1", description="Board B", vid=0x1A86, pid=0x55D4),
        SimpleNamespace(device="/dev/ttyACM0", description="Board A", vid=0x1A86, pid=0x55D4),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    listed = [path.removeprefix("/dev/tty") for path, _ in System().ports(["1a86:55d4"])]
    assert listed == ["ACM0", "ACM1", "USB0", "S0"]
    assert dict(System().ports(["1a86:55d4"]))["/dev/ttyUSB0"] == "USB Serial, USB 1a86:7523"
    assert "the board's" in dict(System().ports(["1a86:55d4"]))["/dev/ttyACM0"]
    assert "the board's" not in " ".join(what for _, what in System().ports([]))


def test_listing_really_lists() -> None:
    for path, description in System().ports(()):
        assert stat.S_ISCHR(os.stat(path).st_mode), description


def test_a_burst_that_is_not_written_is_told() -> None:
    with new_pty() as pty:
        pty.fill()
        before = open_fds()
        told, [found] = stop_path.by_hand(os.ttyname(pty.slave), {"rrc": BOARD}, "failstop doctor")
        assert open_fds() == before
    assert told == []
    assert (found.level, found.fix) == (FAIL, "failstop doctor")
    assert found.text.startswith("no stop was written: /dev/pts/")
    assert "POWER SWITCH" in found.advice


def test_a_usb_chip_without_a_port_is_found(tmp_path: Path) -> None:
    for name, usb in (("1-1", "10c4:ea60"), ("1-2", "0403:6001"), ("1-3", "1d6b:0002"), ("1-1.4", "1a86:7523")):
        for half, value in zip(("idVendor", "idProduct"), usb.split(":"), strict=True):
            write(tmp_path, f"/sys/devices/usb1/{name}/{half}", f"{value}\n")
        (tmp_path / "sys/bus/usb/devices").mkdir(parents=True, exist_ok=True)
        (tmp_path / "sys/bus/usb/devices" / name).symlink_to(tmp_path / "sys/devices/usb1" / name)
    port = tmp_path / "sys/devices/usb1/1-1.4/1-1.4:1.0/ttyUSB0"
    port.mkdir(parents=True)
    (tmp_path / "sys/class/tty/ttyUSB0").mkdir(parents=True)
    (tmp_path / "sys/class/tty/ttyUSB0/device").symlink_to(port)
    system = System(str(tmp_path))
    assert system.portless(["10c4:ea60", "0403:6001", "1a86:7523"]) == ["0403:6001", "10c4:ea60"]
    assert system.portless(["1a86:7523"]) == []
    assert System(str(tmp_path / "nothing")).portless(["1a86:7523"]) == []

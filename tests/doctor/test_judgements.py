"""The judgements: on a machine that is well they find nothing, and each thing that is not is found, with a remedy."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from failstop import config
from failstop.api.snapshot import Ages, Client, Scale, Starved
from failstop.board.finder import Device
from failstop.board.kinds import board_of
from failstop.board.rrc.board import BOARD
from failstop.doctor import port, stop_path
from failstop.doctor.look import FAIL, LEVELS, OK, SKIP, WARN, Look
from failstop.doctor.machine import PROCESSORS
from failstop.doctor.service import ALONE
from failstop.doctor.system import Holder
from failstop.doctor.table import CHECKS, examine
from failstop.files import durable, place
from failstop.policy import causes
from failstop.policy.scale import capped
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.version import VERSION
from tests.doctor.parts import NOBODY, NODE, STATE, STATE_FOLDER, UNIT, but, look, of, on, serving
from tests.support.states import TURNED, TURNS, arm, stop

UNRIGHTED = {name: but(row, realtime=False, memory_locked=False) for name, row in STATE.processes.items()}
UNLOCKED = {name: but(row, memory_locked=False) for name, row in STATE.processes.items()}
STARVED = Starved(0.07, "gate")
PORT = STATE.device
VENDORS = "/home/ws/ugv_rpi/ugv-env/bin/python /home/ws/ugv_rpi/app.py"
BRIDGE = Client(0, "ros2", 7, False, "no scan", "/a and /b drive", 0.1)
DRIVER = Client(0, "nav", 42, True, sees="uses the guard port /p")
WAITS = Client(0, "failstop guard", 41, False, sees="no driver has opened the guard port /p")
NO_SENSOR = Settings({"scan.gate": "off"})
BRIDGED = serving(clients=(but(BRIDGE, said_s=None),))
RESTARTING = but(UNIT, ActiveState="activating", SubState="auto-restart", NRestarts="3")
LIDAR = {"/dev/ttyACM1": Device("1a86", "55d4", "B", "1.0", "1-1.3")}
BY_ID = "/dev/serial/by-id/usb-1a86_USB_Single_Serial_A-if00"
REMOVED = {7: {"/dev/ttyACM0 (deleted)", "/dev/ttyACM1"}}
DEAF = "LoadState=loaded\nActiveState=active\nStatusText=obeys no fleet stop: no key\nStatusErrno=107\n"
"""Words of systemd about the robot's publisher."""
INSTALLED = ("/etc/failstop/failstop.toml", Settings(), "")
AT_HOME = ["/", "/etc", "/home", "/home/anna/robot.toml"]
EXECUTED = "{ path=/x ; argv[]=/opt/failstop/bin/failstop run --config /etc/failstop/failstop.toml ; ignore_errors=no }"
BY_HAND: dict[str, Any] = {"unit": {}, "owners": {"/proc/100": "anna"}}
"""Started by a person."""


def absent(name: str, **changed: Any) -> Any:
    """The service, with one process like this."""
    return serving(processes={**STATE.processes, name: but(STATE.processes[name], **changed)})


def linked(link: str, **changed: Any) -> Any:
    """The service, with this of the board's answers."""
    return serving(device=but(PORT, link=link), **changed)


def ported(port: str, link: str = "unheard") -> Any:
    """The service, with its port like this. The link's state is then about a port that is to come."""
    return serving(device=but(PORT, state=port, link=link), last_stop=stop())


def nodes(*users: str) -> dict[str, Any]:
    """Nodes of these users, of whom the last has the bridge, with Fast DDS's shared memory."""
    owners = {f"/dev/shm/fastrtps_{user}": user for user in users}
    files = {**dict.fromkeys(owners, ""), "/proc/7/maps": f"7f1c2000-7f1c3000 rw-s 0 00:1a 42 {[*owners][-1]}"}
    return {"files": files, "owners": {**owners, "/proc/7": users[-1]}}


UDP = {"/dev/shm/fastrtps_anna": "", "/proc/7/maps": "7f1c2000-7f1c3000 r-xp 0 08:01 7 /usr/bin/python3"}
"""A bridge without shared memory, beside a node with it."""

CASES: tuple[tuple[str, Look, str, str], ...] = (
    ("port", look(node=None, device=("/", "x")), FAIL, "is not a serial port"),
    ("port", look(node=but(NODE, resolved="/nowhere/dev/failstop")), WARN, "another device may get that number"),
    ("port", look(look_alikes=LIDAR), WARN, "or /dev/ttyACM1: both have the same USB chip"),
    ("port", look(look_alikes=LIDAR, device=("/dev/failstop", "x")), WARN, "or /dev/ttyACM1"),
    ("port", look(look_alikes=LIDAR, device=(BY_ID, "x"), twins=True), WARN, "or /dev/ttyACM1"),
    ("identity", look(usb_id="0403:6001"), FAIL, "0403:6001"),
    ("identity", look(usb_id=""), SKIP, "is not a USB device"),
    ("permission", look(node=but(NODE, accessible=False), service=NOBODY, unit={}), FAIL, "anna may not open"),
    ("permission", look(barrier="/dev/ttyACM0", service=NOBODY), FAIL, "user failstop may not open /dev/ttyACM0"),
    ("holders", look(holders=((Holder(7, "python3"),), 0)), FAIL, "python3 (pid 7)"),
    ("holders", look(holders=((Holder(7, "driver", "old.service"),), 0)), FAIL, "old.service"),
    ("holders", look(holders=((Holder(7, "fs:gate", instance="left"),), 0)), FAIL, "the service 'left' has the port"),
    ("holders", look(opens=REMOVED, files=on("minicom", 7)), WARN, "/dev/ttyACM0 open since before"),
    ("holders", look(node=None, opens=REMOVED, files=on("minicom", 7)), WARN, "minicom (pid 7)"),
    ("holders", look(holders=((), 3)), WARN, "3 processes couldn't be checked"),
    ("holders", look(hides_processes=True), WARN, "can't see the processes of other users"),
    ("grabbers", look(hides_processes=True), SKIP, "whether brltty is running: this user can't see"),
    (
        "grabbers",
        look(hides_processes=True, node=but(NODE, modem_ignored=False)),
        SKIP,
        "whether ModemManager or brltty is running: this user can't see",
    ),
    ("console", look(hides_processes=True), SKIP, "whether a login waits on it: this user can't see"),
    (
        "commanders",
        look(hides_processes=True, active_settings=of("ugv")),
        SKIP,
        "whether a program that drives this board is running: this user can't see",
    ),
    ("RemoveIPC", look(hides_processes=True, owners={"/proc/100": ""}), SKIP, "can't see who runs the service"),
    (
        "state directory",
        look(owners={STATE_FOLDER: ""}, missing=False),
        SKIP,
        f"this user can't see {STATE_FOLDER}, so it was not checked",
    ),
    ("state directory", look(owners={"/proc/100": ""}), SKIP, "can't see who runs the service"),
    (
        "identity",
        look(usb_id="2341:0043", active_settings=of("ugv")),
        WARN,
        "is USB 2341:0043, which is a board of the kind arduino",
    ),
    ("board", look(service=linked("deaf")), FAIL, "the board does not hear"),
    ("board", look(service=linked("silent", ages=Ages(4.0))), FAIL, "has said nothing for 4.0 s"),
    ("stop path", look(service=linked("silent", ages=Ages(4.0))), FAIL, "has said nothing for 4.0 s"),
    ("service", look(service=linked("silent", ages=Ages(4.0))), FAIL, "has said nothing for 4.0 s"),
    ("board", look(service=linked("unproven", battery_v=7.2)), WARN, "questions, and reports a battery of 7.2 V"),
    (
        "board",
        look(service=linked("unasked"), active_settings=of("hoverboard")),
        WARN,
        "it has reported nothing so far",
    ),
    (
        "commanders",
        look(files=on("python3", command=VENDORS), active_settings=of("ugv")),
        WARN,
        "(pid 9) runs: the vendor",
    ),
    ("commanders", look(active_settings=of("ugv")), WARN, "its Wi-Fi: "),
    ("commanders", look(active_settings=of("ugv")), WARN, "ESP-NOW: "),
    ("commanders", look(active_settings=of("hoverboard")), WARN, "its second cable: "),
    ("grabbers", look(files=on("ModemManager"), node=but(NODE, modem_ignored=False)), FAIL, "ModemM"),
    ("grabbers", look(files=on("ModemManager"), node=None), FAIL, "ModemM"),
    ("grabbers", look(files=on("brltty")), WARN, "brltty"),
    ("console", look(files={"/proc/cmdline": "quiet console=ttyACM0,115200"}), FAIL, "the kernel writes its messages"),
    ("console", look(files=on("agetty", command="/sbin/agetty -8 - ttyACM0 vt220")), FAIL, "agetty (pid 9)"),
    ("console", look(says={"systemctl": "active\n"}), FAIL, "a login waits on /dev/ttyACM0"),
    ("settings", look(settings=("x.toml", Settings(), "gate.lease_s = 9.0: it must be")), FAIL, "gate.lease_s = 9.0"),
    (
        "settings",
        look(settings=("x.toml", Settings({"board.kind": "feetech", "limits.vx_mps": 0.5}), "")),
        FAIL,
        "lower [limits], or see board.per_rps; the service won't start until this is fixed",
    ),
    (
        "settings",
        look(settings=("/x.toml", Settings(), "Permission denied"), barrier="/x.toml", service=NOBODY),
        FAIL,
        "/x.toml can't be read by failstop, so the service won't start",
    ),
    (
        "settings",
        look(settings=INSTALLED, barrier="/home/anna", service=NOBODY),
        FAIL,
        "failstop.toml can't be read by failstop, because /home/anna keeps that user out, so the service won't start",
    ),
    (
        "settings",
        look(settings=INSTALLED, through=AT_HOME, unit=but(UNIT, ProtectHome="yes"), service=NOBODY),
        FAIL,
        "failstop.toml leads to /home/anna/robot.toml, which ProtectHome=yes hides from the service",
    ),
    (
        "settings",
        look(settings=INSTALLED, through=["/var/tmp/x.toml"], unit=but(UNIT, PrivateTmp="yes")),
        FAIL,
        "failstop.toml leads to /var/tmp/x.toml, which PrivateTmp=yes hides from the service",
    ),
    (
        "settings",
        look(active_settings=of("ugv"), settings=("x.toml", Settings(), "")),
        WARN,
        "other settings than those in x.toml: board",
    ),
    (
        "protection",
        look(active_settings=Settings({"board.kind": "arduino", "battery.stop_mv": 10_500})),
        WARN,
        "battery.stop_mv = 10500 never stops the robot, because board.kind arduino reports no battery",
    ),
    (
        "protection",
        look(active_settings=Settings({"board.imu": "off", "still.command": "true"})),
        WARN,
        'still.command never runs, because with board.imu = "off" nothing on board.kind rrc shows',
    ),
    (
        "settings",
        look(settings=INSTALLED, exposed="/etc/failstop"),
        FAIL,
        "others may write /etc/failstop, so they can",
    ),
    (
        "settings",
        look(settings=INSTALLED, exposed="/etc/failstop", active_settings=of("ugv")),
        WARN,
        "other settings than those in /etc/failstop/failstop.toml: board",
    ),
    ("deaths", look(early_news=False), WARN, "reports a process's death late"),
    ("service", look(service=NOBODY), WARN, "no service named 'failstop' is running"),
    ("service", look(service=(None, "", "is of failstop 0.0.9")), FAIL, "0.0.9"),
    ("service", look(service=absent("supervisor", state="suspended")), FAIL, "supervisor (pid 100) is suspended; it"),
    ("service", look(service=absent("stopper", state="hanging")), FAIL, "stopper (pid 104) is hanging"),
    ("service", look(service=absent("supervisor", state="dead")), FAIL, "supervisor (pid 100) is dead"),
    ("service", look(service=absent("gate", pid=0, state="down")), FAIL, "gate died too often and is down until a"),
    (
        "service",
        look(service=absent("telemetry", pid=0, state="waiting", last_exit="killed by SIGKILL", killed=True)),
        FAIL,
        "telemetry is waiting, after it was killed by SIGKILL",
    ),
    ("service", look(service=absent("gate", state="starting")), WARN, "gate (pid 102) is starting"),
    ("board", look(service=absent("telemetry", state="suspended")), SKIP, "telemetry is suspended, so nobody watches"),
    ("service", look(service=linked("deaf")), FAIL, "does not hear"),
    ("service", look(service=linked("unheard")), FAIL, "has not answered since it came back"),
    ("service", look(service=ported("lost")), FAIL, "the port /dev/ttyACM0 is lost, so no stop reaches the board"),
    ("service", look(service=ported("closed")), FAIL, "the port /dev/ttyACM0 is closed"),
    ("board", look(service=ported("lost")), FAIL, "the port /dev/ttyACM0 is lost"),
    ("board", look(service=ported("closed", "alive")), FAIL, "the port /dev/ttyACM0 is closed"),
    ("stop path", look(service=ported("lost")), FAIL, "is lost, so no stop reaches the board, whatever its last stop"),
    ("stop path", look(service=linked("unheard")), FAIL, "has not answered since it came back"),
    ("service", look(service=linked("unproven")), WARN, "waits for the board's first answer"),
    ("service", look(service=serving(waiting_for="the port")), WARN, "waits for the port"),
    ("service", look(service=serving(waiting_for="telemetry", turning=TURNED)), FAIL, "turning at the last reading"),
    (
        "service",
        look(service=linked("unproven", turning=but(TURNS, unexpected=True))),
        FAIL,
        "the wheels turn although they are told to stop",
    ),
    ("service", look(service=serving(arm=arm(wrong=("it hangs",)))), WARN, "it hangs"),
    (
        "service",
        look(service=serving(servos={"left wheel (servo 7)": (0.1, 70)})),
        WARN,
        "left wheel (servo 7) is at 70 C",
    ),
    ("clients", look(service=serving(clients=(BRIDGE,))), WARN, "/a and /b drive"),
    ("ROS 2", look(**nodes("anna", "bob"), service=BRIDGED), WARN, "Fast DDS of anna is here"),
    ("guard", look(service=serving(clients=(DRIVER,))), WARN, "scan.gate is on"),
    ("unit", look(unit={}), WARN, "no unit"),
    ("unit", look(unit={}, says={"systemctl": None}), SKIP, "systemd can't be asked about failstop.service"),
    ("unit", look(unit={}, says={"systemctl": None}, booted=False), WARN, "systemd is not running here"),
    ("RemoveIPC", look(**BY_HAND, says={"busctl": None}), SKIP, "logind can't be asked"),
    ("RemoveIPC", look(**BY_HAND, says={"busctl": "no idea"}), SKIP, "logind can't be asked"),
    ("fleet", look(says={"systemctl": None}), SKIP, "systemd can't be asked about failstop-fleet.service"),
    ("unit", look(unit=but(UNIT, ActiveState="failed", Result="watchdog")), FAIL, "watchdog"),
    ("unit", look(unit=but(UNIT, ActiveState="inactive", Result="watchdog")), FAIL, "result: watchdog"),
    ("unit", look(unit=but(UNIT, NRestarts="3")), WARN, "restarted by systemd: 3"),
    ("unit", look(unit=RESTARTING), FAIL, "auto-restart"),
    ("unit", look(unit=but(UNIT, UnitFileState="disabled")), WARN, "does not start at boot"),
    ("rights", look(service=serving(processes=UNRIGHTED)), WARN, "supervisor, port_owner"),
    ("rights", look(service=serving(processes=UNLOCKED)), WARN, "supervisor, port_owner"),
    ("rights", look(service=serving(processes=UNRIGHTED, starved=STARVED)), WARN, "for 70 ms; these processes lack"),
    ("rights", look(service=serving(starved=STARVED)), WARN, "for 70 ms, in spite of"),
    (
        "rights",
        look(service=serving(processes=UNRIGHTED, lease_s=0.2)),
        WARN,
        "the robot stops after 200 ms instead of",
    ),
    ("rights", look(service=NOBODY, realtime=False), WARN, "this user can't get real-time priority"),
    ("shared memory", look(room=None), FAIL, "this user can't write to /dev/shm"),
    ("shared memory", look(room=1024, service=NOBODY), FAIL, "1 KiB free"),
    ("fleet", look(says={"systemctl": DEAF}), WARN, "obeys no fleet stop: no key"),
    ("RemoveIPC", look(**BY_HAND), WARN, "when anna logs out"),
    ("RemoveIPC", look(service=NOBODY, unit={}), WARN, "when anna logs out"),
    ("state directory", look(no_room="the disk of / is full (0 kB free)"), WARN, "is full (0 kB free), so incidents"),
    ("state directory", look(writable=False), WARN, "can't write to /var/lib/failstop/failstop, so incidents"),
    ("state directory", look(**BY_HAND, writable=False), WARN, "can't write to /state"),
    ("state directory", look(**BY_HAND, environ=None), SKIP, "can't see where the service keeps its incidents"),
    ("processor", look(files={f"{PROCESSORS}/cpu1/cpufreq/scaling_governor": "powersave"}), WARN, "powersave"),
    ("ticks", look(quick=True), SKIP, "not measured"),
    ("ticks", look(ticks=(True, [1000, 41_000_000])), FAIL, "after 40 ms the lease runs out"),
    ("scale", look(service=serving(scale=Scale(capped="speed capped at 0.05 m/s"))), WARN, "capped at 0.05 m/s"),
    ("scale", look(service=serving(scale=Scale(wheels=5.0, wrong=("turn 5 times",)))), WARN, "turn 5 times"),
    (
        "scale",
        look(service=NOBODY, active_settings=of("arduino")),
        WARN,
        "speed capped at 0.05 m/s, because nobody has confirmed",
    ),
    ("ticks", look(ticks=(True, [1000, 6_000_000])), WARN, "worst 6000 us"),
    ("ticks", look(ticks=(False, [1000, 41_000_000])), WARN, "without real-time priority"),
    (
        "ticks",
        look(service=serving(lease_s=0.1), ticks=(False, [1000, 81_000_000])),
        WARN,
        "after 80 ms the lease runs",
    ),
    ("ticks", look(service=NOBODY, ticks=(False, [1000, 181_000_000])), WARN, "after 180 ms the lease runs out"),
    (
        "stop path",
        look(service=serving(last_stop=stop(acknowledged_s=None))),
        WARN,
        "has not acknowledged the service's last",
    ),
    ("stop path", look(service=serving(last_stop=None)), SKIP, "has had no stop yet"),
)


def test_without_rights_a_tick_may_be_as_late_as_the_lease_that_a_start_takes() -> None:
    [finding] = CHECKS["ticks"](look(service=NOBODY, ticks=(False, [1000, 41_000_000])))
    assert finding.level == OK


def test_on_a_machine_that_is_well_every_check_says_so() -> None:
    found = examine(look())
    assert {name for name, _ in found} == CHECKS.keys()
    wrong = [finding for name, finding in found if name != "commanders" and (finding.level != OK or finding.fix)]
    assert wrong == []


def said(given: Look, check: str) -> list[tuple[str, str, str]]:
    return [(row.text, row.fix, row.advice) for name, row in examine(given) if name == check]


UNREADABLE = (None, "", "is of another version")
RUNS = f"'failstop' is running (pid 100, user failstop, failstop {VERSION}"
WELL = "device open, the board answers, motion"
FT232 = "USB 0403:6001, a FT232 chip: many devices have one, so it doesn't tell which board this is"
READ = (
    "the service reads it as hoverboard, which answers no questions, and reports a battery of 36.1 V; its last "
    "report was "
    "0.0 s ago"
)
OPENED = ((Holder(101, "fs:port_owner", "failstop.service", "failstop"),), 0)


@pytest.mark.parametrize(
    ("check", "given", "says"),
    [
        ("port", look(), "/dev/ttyACM0 (the default)"),
        ("port", look(node=but(NODE, resolved="/dev/x")), "/dev/ttyACM0, which is /dev/x (the default)"),
        ("permission", look(), "the running service opens the port; it is open"),
        ("permission", look(service=NOBODY, unit={}), "anna may open it"),
        ("permission", look(service=NOBODY, account=-1), "anna may open it"),
        (
            "permission",
            look(service=NOBODY, node=but(NODE, accessible=False)),
            "failstop, the user of failstop.service, may open it",
        ),
        ("holders", look(), "no program has it open"),
        ("holders", look(holders=OPENED), "only the service has it open"),
        ("holders", look(holders=OPENED, service=UNREADABLE), "only the service has it open"),
        ("grabbers", look(), "neither ModemManager nor brltty is running"),
        ("console", look(), "no login waits on it, and the kernel writes no messages to it"),
        (
            "console",
            look(files=on("agetty", command="/sbin/agetty -8 - tty1 linux")),
            "no login waits on it, and the kernel writes no messages to it",
        ),
        (
            "grabbers",
            look(files=on("ModemManager")),
            "ModemManager is running, but a rule tells it to leave this port alone",
        ),
        ("service", look(), f"{RUNS}), {WELL} disabled"),
        ("service", look(service=serving(enabled=True)), f"{RUNS}), {WELL} enabled"),
        (
            "service",
            look(service=serving(cause=causes.KEY(1), estop="key1")),
            f"{RUNS}), {WELL.removesuffix('motion')}a stop is latched: key1",
        ),
        ("identity", look(usb_id="2341:0043", active_settings=of("arduino")), "USB 2341:0043, as the board has it"),
        ("identity", look(usb_id="0403:6001", active_settings=of("ugv")), FT232),
        (
            "identity",
            look(usb_id="1209:2444", active_settings=of("ugv")),
            "USB 1209:2444; a board of the kind ugv may be at any port",
        ),
        (
            "identity",
            look(usb_id="", active_settings=of("ugv")),
            "no USB device; a board of the kind ugv may be at any port",
        ),
        ("board", look(), "it answers the service's questions as rrc does, and reports a battery of 12.0 V"),
        (
            "board",
            look(service=linked("unasked", battery_v=36.1, ages=Ages(0.01)), active_settings=of("hoverboard")),
            READ,
        ),
        ("scale", look(), "not compared yet; the next curve will show it"),
        (
            "scale",
            look(service=serving(scale=Scale(wheels=0.98))),
            "they turn 0.98 times as fast as commanded, as the board reports them",
        ),
        (
            "scale",
            look(service=NOBODY, active_settings=of("hoverboard")),
            "board.per_rps is 60, and the next drive shows whether it is right",
        ),
        ("scale", look(active_settings=of("feetech")), ALONE),
        (
            "commanders",
            look(active_settings=of("arduino")),
            "failstop knows of nothing else here that could drive this board",
        ),
        ("ROS 2", look(**nodes("anna")), "no bridge to ROS 2 is connected"),
        (
            "guard",
            look(),
            "no guard port is open; you need one only to keep a driver that was written for the bare board",
        ),
        (
            "guard",
            look(service=serving(clients=(DRIVER,)), active_settings=NO_SENSOR),
            "nav (pid 42) uses the guard port /p",
        ),
        (
            "guard",
            look(service=serving(clients=(WAITS,)), active_settings=NO_SENSOR),
            "the guard port is /p; no driver has it open",
        ),
        ("unit", look(), "failstop.service is active, and it starts at boot"),
        ("RemoveIPC", look(), "the service runs as a system user, so RemoveIPC does not matter"),
        ("RemoveIPC", look(**BY_HAND, says={"busctl": "b false\n"}), "RemoveIPC is off"),
        ("state directory", look(), "/var/lib/failstop/failstop has room"),
        ("state directory", look(**BY_HAND), "/state has room"),
        (
            "state directory",
            look(**BY_HAND, environ={"STATE_DIRECTORY": "/a/b"}),
            "/a/b does not exist yet, and can be made",
        ),
        (
            "state directory",
            look(owners={STATE_FOLDER: ""}),
            f"{STATE_FOLDER} does not exist yet: systemd makes it when the service starts",
        ),
        ("stop path", look(), "the service's last stop: acknowledged by the board after 4.4 ms"),
    ],
)
def test_what_is_said_where_all_is_well(check: str, given: Look, says: str) -> None:
    assert [text for text, *_ in said(given, check)] == [says]


@pytest.mark.parametrize(("kind", "fitted", "level"), [("rrc", True, WARN), ("rrc", False, OK), ("ugv", True, "")])
def test_an_imu_that_would_observe_the_wheels_and_is_not_there_is_told(kind: str, fitted: bool, level: str) -> None:
    device = but(PORT, imu=fitted)
    found = CHECKS["service"](look(service=serving(imu=None, device=device), active_settings=of(kind)))
    assert [row.level for row in found if "no IMU reports" in row.text] == [level] * bool(level)


def test_a_service_of_another_version_is_told_from_this_command() -> None:
    [(text, *_)] = said(look(service=(STATE, "0.0.9", "")), "service")
    assert text.startswith(
        f"'failstop' is running (pid 100, user failstop, failstop 0.0.9, this command is {VERSION}), "
    )


def test_a_service_with_a_suspended_process_is_not_called_fine() -> None:
    found = CHECKS["service"](look(service=absent("supervisor", state="suspended")))
    assert [row.level for row in found] == [FAIL]
    lost = but(absent("supervisor", state="suspended")[0], device=but(PORT, state="lost"))
    found = CHECKS["service"](look(service=(lost, VERSION, "")))
    assert [row.level for row in found] == [FAIL, FAIL], "and its port is lost"


def test_other_services_are_named() -> None:
    [(text, *_)] = said(look(service=NOBODY, services=["left", "right"]), "service")
    assert text.endswith(" (running: left, right)")


SWITCHED = "sudo systemctl disable --now failstop-ros2@bob && sudo systemctl enable --now failstop-ros2@anna"


@pytest.mark.parametrize(
    ("check", "given", "fix", "advice"),
    [
        (
            "permission",
            look(barrier="/dev/ttyACM0", service=NOBODY),
            "sudo usermod -aG dialout failstop",
            "then start the service",
        ),
        ("permission", look(barrier="/dev/x", service=NOBODY, node=but(NODE, by_group=False)), "", "udev rule"),
        ("permission", look(barrier="/dev/x", service=NOBODY, node=but(NODE, group="root")), "", "udev rule"),
        ("holders", look(holders=((Holder(7, "python3"),), 0)), "sudo kill 7", ""),
        ("holders", look(holders=((Holder(7, "x", "old.service"),), 0)), "sudo systemctl stop old.service", ""),
        (
            "holders",
            look(holders=((Holder(7, "x", command=VENDORS),), 0), active_settings=of("ugv")),
            "crontab -e",
            "then reboot",
        ),
        ("holders", look(holders=((), 3)), 'sudo "$(command -v failstop)" doctor', "root can check them all"),
        ("settings", look(settings=INSTALLED, exposed="/my files"), "sudo chmod go-w '/my files'", ""),
        ("service", look(service=UNREADABLE), "sudo systemctl restart failstop.service", "stops the wheels"),
        ("service", look(service=UNREADABLE, unit={}), "", "stops the wheels"),
        ("service", look(service=absent("supervisor", state="suspended")), "sudo kill -CONT 100", "`fg`"),
        (
            "service",
            look(service=absent("stopper", state="hanging")),
            "sudo systemctl restart failstop.service",
            "stops",
        ),
        ("service", look(service=absent("gate", state="hanging"), unit={}), "failstop why", "restart the service"),
        ("service", look(service=absent("gate", pid=0, state="down")), "failstop why", "what to do next"),
        ("service", look(service=absent("supervisor", state="dead")), "failstop run", "POWER SWITCH"),
        ("rights", look(service=serving(processes=UNRIGHTED)), "sudo systemctl edit failstop.service", "LimitRTPRIO"),
        ("stop path", look(service=serving(last_stop=None)), "failstop stop", "`failstop reset`"),
        ("ROS 2", look(**nodes("anna", "bob"), service=BRIDGED), SWITCHED, "UDP alone"),
    ],
)
def test_the_remedy_fits_the_case(check: str, given: Look, fix: str, advice: str) -> None:
    [(_, found, besides)] = said(given, check)
    assert found == fix
    assert advice in besides


def test_the_verdict_on_a_burst() -> None:
    [found] = stop_path.judged("stop tool", BOARD, 4.5, "failstop doctor")
    assert (found.level, found.text) == (OK, "stop tool: acknowledged by the board after 4.5 ms")
    [found] = stop_path.judged("stop tool", BOARD, None, "failstop doctor")
    assert (found.level, found.fix) == (FAIL, "failstop doctor")
    assert "did not answer the ping after it" in found.text


UNTOUCHED = but(NODE, accessible=False)
ACM = "/dev/ttyACM0"


@pytest.mark.parametrize(
    ("changed", "why", "fix"),
    [
        ({"service": UNREADABLE}, "the running service can't be asked", ""),
        ({"node": None}, "there is no port", ""),
        ({"node": UNTOUCHED}, "this user may not open the port", ""),
        ({"holders": ((Holder(7, "x"),), 0)}, "x (pid 7) has the port open", ""),
        ({"settings": ("x", Settings(), "wrong")}, "the settings that name the board can't be used", ""),
        ({"usb_id": ""}, f"{ACM} may not be the board, so nothing is written to it", f"failstop doctor --device {ACM}"),
    ],
)
def test_where_the_stop_path_is_left_alone(changed: dict[str, Any], why: str, fix: str) -> None:
    given = look(**{"service": NOBODY, **changed})
    for check in ("board", "stop path"):
        assert said(given, check) == [(f"not tested: {why}", fix, "" if fix else "fix that first")]


@pytest.mark.parametrize(
    "changed", [{}, {"node": but(NODE, pseudo=True), "usb_id": ""}, {"usb_id": "", "device_path": "/dev/x"}]
)
def test_where_it_is_tried(changed: dict[str, Any]) -> None:
    [(text, *_)] = said(look(service=NOBODY, device=("/nowhere", ""), **changed), "stop path")
    assert text.startswith("no stop was written: ")
    assert "/nowhere" in text


@pytest.mark.parametrize(
    ("devices", "says", "fix"),
    [
        ([("/dev/ttyACM1", "x, USB 1a86:55d4")], "found: /dev/ttyACM1", "failstop doctor --device /dev/ttyACM1"),
        (
            [(f"/dev/ttyACM{number}", "x, USB 1a86:55d4") for number in (1, 2)],
            "found: /dev/ttyACM1",
            "ls -l /dev/serial/by-path",
        ),
        ([("/dev/ttyS0", "n/a")], "no USB serial device is plugged in", "sudo dmesg | tail"),
    ],
)
def test_a_device_that_is_not_there(devices: list[tuple[str, str]], says: str, fix: str) -> None:
    [finding] = [finding for name, finding in examine(look(node=None, ports=devices)) if name == "port"]
    assert finding.level == FAIL
    assert "no device /dev/ttyACM0 (the default); " in finding.text
    assert says in finding.text
    assert finding.fix == fix
    assert ("set device.path to /dev/ttyACM" in finding.advice) == (len(devices) == 1 and "ttyACM1" in says)


@pytest.mark.parametrize(
    ("usb", "files", "says", "fix"),
    [
        (
            "10c4:ea60",
            on("brltty"),
            "USB 10c4:ea60 (CP210x) is plugged in but has no serial port, because brltty",
            "purge brltty",
        ),
        ("0403:6001", on("brltty"), "USB 0403:6001 (FT232) is plugged in", "sudo apt purge brltty"),
        ("10c4:ea60", {}, "because no driver has taken it", "sudo modprobe cp210x"),
        ("0403:6015", {}, "because no driver has taken it", "sudo modprobe ftdi_sio"),
        ("1a86:7523", {}, "because no driver has taken it", "sudo modprobe ch341"),
        ("1a86:55d3", {}, "because no driver has taken it", "sudo modprobe cdc_acm"),
        ("1a86:55d4", {}, "because no driver has taken it", "sudo modprobe cdc_acm"),
        ("2341:0043", {}, "because no driver has taken it", "sudo modprobe cdc_acm"),
    ],
)
def test_a_chip_that_is_plugged_in_without_a_port_is_named(
    usb: str, files: dict[str, str | None], says: str, fix: str
) -> None:
    changed = look(node=None, ports=[("/dev/ttyS0", "n/a")], portless=[usb], files=files)
    [finding] = [finding for name, finding in examine(changed) if name == "port"]
    assert says in finding.text
    assert fix in finding.fix
    assert "no USB serial device is plugged in" not in finding.text


@pytest.mark.parametrize(
    ("check", "changed"),
    [
        ("holders", {"holders": ((Holder(7, "python3"),), 0)}),
        ("grabbers", {"files": on("brltty")}),
        ("console", {"files": {"/proc/cmdline": "console=ttyACM0"}}),
    ],
)
def test_what_is_seen_although_proc_hides_others_is_said(check: str, changed: dict[str, Any]) -> None:
    found = CHECKS[check](look(hides_processes=True, **changed))
    assert found
    assert "can't see" not in str(found)


def test_brltty_may_have_taken_a_port_although_it_is_not_seen() -> None:
    changed = look(node=None, portless=["10c4:ea60"], hides_processes=True)
    [(_, fix, advice)] = said(changed, "port")
    assert fix == "sudo modprobe cp210x"
    assert "sudo apt purge brltty" in advice


def test_a_user_that_is_not_seen_is_not_named() -> None:
    [(text, *_)] = said(look(owners={"/proc/100": ""}), "service")
    assert text.startswith(f"'failstop' is running (pid 100, failstop {VERSION})")


def test_a_port_that_our_rule_does_not_know_is_kept_from_modemmanager_by_a_command() -> None:
    changed = look(files=on("ModemManager"), node=but(NODE, modem_ignored=False), usb_id="dead:beef")
    [(_, fix, _)] = said(changed, "grabbers")
    assert fix == "sudo systemctl disable --now ModemManager"


@pytest.mark.parametrize(("check", "given", "level", "says"), CASES)
def test_what_is_wrong_is_found(check: str, given: Look, level: str, says: str) -> None:
    found = [finding for name, finding in examine(given) if name == check and finding.level == level]
    assert any(says in finding.text for finding in found), examine(given)
    assert all(finding.fix or finding.advice or level == SKIP for finding in found), "every one has a remedy"
    assert all("\n" not in finding.text for finding in found)


def test_every_check_can_fail_or_warn() -> None:
    assert {check for check, *_ in CASES} == CHECKS.keys()


def test_a_service_that_runs_without_rights_is_judged_and_not_the_person_who_asks() -> None:
    assert all(finding.level == OK for name, finding in examine(look(realtime=False)) if name == "rights")


@pytest.mark.parametrize(
    ("changed", "ignored"),
    [
        ({"room": 0}, ("shared memory",)),
        ({"service": NOBODY}, ("RemoveIPC",)),
        ({"files": on("ModemManager")}, ("grabbers",)),
        ({"files": on("ModemManager"), "node": but(NODE, pseudo=True, modem_ignored=False)}, ("grabbers",)),
        ({"holders": OPENED}, ("holders",)),
        ({"node": but(NODE, pseudo=True), "usb_id": ""}, ("identity",)),
        ({"service": serving(processes=STATE.processes, clients=(but(BRIDGE, wrong=""),))}, ("clients",)),
        ({**nodes("anna", "bob"), "files": UDP, "service": BRIDGED}, ("ROS 2",)),
        ({**nodes("bob"), "service": BRIDGED}, ("ROS 2",)),
    ],
)
def test_what_is_no_fault(changed: dict[str, Any], ignored: tuple[str, ...]) -> None:
    assert [finding for name, finding in examine(look(**changed)) if name in ignored and finding.level != OK] == []


def fixes(given: Look) -> dict[str, str]:
    return {name: finding.fix for name, finding in examine(given) if finding.fix}


def test_the_gravest_comes_first() -> None:
    given = look(node=None, service=NOBODY, quick=True)
    levels = [LEVELS.index(finding.level) for _, finding in examine(given)]
    assert levels == sorted(levels, reverse=True)
    assert set(levels) == set(range(len(LEVELS)))


def test_who_is_let_into_which_group() -> None:
    def closed(group: str) -> tuple[str, str]:
        node = but(NODE, accessible=False, group=group)
        [(_, *remedy)] = said(look(node=node, service=NOBODY, unit={}), "permission")
        return remedy[0], remedy[1]

    assert closed("dialout") == ("sudo usermod -aG dialout anna", "then log out and in again")
    assert closed("root") == port.RULE, "not root's group"


def test_how_a_service_that_does_not_run_is_started() -> None:
    assert fixes(look(service=NOBODY))["service"] == "sudo systemctl start failstop.service"
    assert fixes(look(service=NOBODY, unit={}))["service"] == "failstop run --device /dev/ttyACM0"
    device = ("/dev/my board", "/etc/x.toml")
    named = look("left", service=NOBODY, unit={}, device=device, settings=("/etc/x.toml", Settings(), ""))
    assert fixes(named)["service"] == "failstop run --name left --config /etc/x.toml --device '/dev/my board'"
    assert "service" not in fixes(look(service=NOBODY, unit={}, node=None)), "first the port"


def test_ticks_in_numbers() -> None:
    [(text, *_)] = said(look(ticks=(False, [n * 1000 for n in range(100, -1, -1)])), "ticks")
    assert text == "delay of a wake-up without real-time priority: median 50 us, p99 99 us, worst 100 us (101 times)"


def test_what_refuses_rights_that_are_granted_already_is_told_in_the_place_of_them() -> None:
    for changed in ({"service": NOBODY, "realtime": False}, {"service": serving(processes=UNRIGHTED)}):
        [(_, fix, advice)] = said(look(**changed, refused="its control group"), "rights")
        assert (fix, advice) == ("", "its control group")
    unlocked = look(service=serving(processes=UNLOCKED), refused="its control group")
    assert "its control group" not in str(said(unlocked, "rights")), "it has real-time priority"


@pytest.mark.parametrize(("contained", "remedy"), [(False, "prlimit --pid $$ --rtprio"), (True, "--cap-add SYS_NICE")])
@pytest.mark.parametrize(
    "changed", [{"service": NOBODY, "realtime": False}, {"service": serving(processes=UNRIGHTED), "unit": {}}]
)
def test_rights_are_granted_by_who_starts_the_service(changed: dict[str, Any], contained: bool, remedy: str) -> None:
    [(_, _, advice)] = said(look(**changed, contained=contained), "rights")
    assert advice.startswith("give it real-time rights: ")
    assert remedy in advice


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (look(active_settings=of("ugv")), "no installed file; 'failstop' runs with settings of its own (board.kind,"),
        (look(active_settings=Settings({"gate.lease_s": 0.2})), "no file: every setting has its default"),
        (look(active_settings=of("ugv"), settings=("x.toml", of("ugv"), "")), "x.toml"),
    ],
)
def test_settings_are_those_of_the_service_that_runs(given: Look, says: str) -> None:
    [found] = [finding for name, finding in examine(given) if name == "settings"]
    assert found.level == OK
    assert found.text.startswith(says)


def test_a_file_that_only_the_service_can_read_is_not_judged() -> None:
    given = look(settings=("/x.toml", Settings(), "Permission denied"), service=NOBODY)
    given.system.barrier = lambda path, uid, *_: path * (uid != given.system.account("failstop"))  # type: ignore
    [found] = [finding for name, finding in examine(given) if name == "settings"]
    assert (found.level, found.text) == (SKIP, "this user can't read /x.toml, so its settings were not checked")
    assert found.fix == "sudo failstop doctor"


@pytest.mark.parametrize(
    "changed",
    [
        {"unit": but(UNIT, ProtectHome="read-only")},
        {"unit": but(UNIT, ProtectHome="yes", ExecStart=EXECUTED), "settings": ("/home/anna/x.toml", Settings(), "")},
        {"unit": but(UNIT, ProtectHome="yes"), "service": serving(processes=STATE.processes), "owners": {}, "pid": 7},
        {"unit": {}},
    ],
    ids=["drop-in", "another file", "by hand", "no unit"],
)
def test_a_file_at_home_that_the_unit_does_not_use_or_may_see_is_fine(changed: dict[str, Any]) -> None:
    if changed.pop("pid", 0):
        changed["unit"] = but(changed["unit"], MainPID="7")
    found = CHECKS["settings"](look(**{"settings": INSTALLED, "service": NOBODY, "through": AT_HOME, **changed}))
    assert [row.level for row in found] == [OK]


def test_a_file_that_the_unit_uses_is_judged_for_its_user() -> None:
    unit = but(UNIT, ExecStart=EXECUTED, User="robot")
    [found] = CHECKS["settings"](look(settings=INSTALLED, service=NOBODY, unit=unit, barrier=INSTALLED[0]))
    assert found.text.startswith(f"{INSTALLED[0]} can't be read by robot")


def test_a_file_that_is_kept_from_the_service_is_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, link = tmp_path / "robot.toml", tmp_path / "failstop.toml"
    file.touch()
    link.symlink_to(file)
    monkeypatch.setattr(config, "installed", lambda _: str(link))
    given = look(settings=(str(link), Settings(), ""), barrier=str(tmp_path), service=NOBODY)
    [(_, fix, _)] = said(given, "settings")
    assert fix == f"sudo install -m 644 {file} {link}"


def test_an_installed_file_that_can_not_be_read_is_not_taken_for_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "failstop.toml"
    file.write_text("")
    refused = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    monkeypatch.setattr(config, "installed", lambda _: str(file))
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(durable, "open_regular", Mock(side_effect=refused))
    given = Look()
    vars(given)["service"] = NOBODY
    path, _, problem = given.settings
    who = place.user(os.geteuid())
    assert (path, problem) == (str(file), f"configuration {file} can't be read by {who}: sudo chmod 644 {file}")
    assert given.device == ("/dev/ttyACM0", "the default")


def test_a_settings_file_in_a_closed_folder_is_not_helped_by_its_own_mode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    monkeypatch.setattr(durable, "open_regular", Mock(side_effect=refused))
    monkeypatch.setattr(os, "stat", Mock(side_effect=refused))
    with pytest.raises(SettingError) as told:
        config.read("/home/anna/x.toml")
    monkeypatch.undo()
    assert str(told.value).endswith(
        f", because a folder above it lets only other users in: move the file to {config.FOLDER}"
    )


def test_a_speed_that_the_service_caps_is_no_setting_of_its_own() -> None:
    """A restart would cap it again."""
    file = Settings({"board.kind": "arduino", "limits.vx_mps": 0.4})
    board = board_of(*file.board())
    assert board.scale_assumed
    runs = look(active_settings=capped(file, assumed=True), settings=("x.toml", file, ""))
    assert said(runs, "settings") == [("x.toml", "", "")]
    runs = look(active_settings=capped(file, assumed=True), settings=("x.toml", of("arduino"), ""))
    assert [text for text, *_ in said(runs, "settings")] == ["x.toml"], "both are capped to the same speed"


def test_a_service_whose_own_board_can_not_be_described_any_more_is_looked_at_all_the_same() -> None:
    """Its folder was edited while it ran; and the file that it was started with is not the installed one."""
    given = look(active_settings=Settings({"board.kind": "/nowhere/tank"}), service=linked("alive", imu=None))
    [(text, fix, advice)] = said(given, "board")
    assert text == "board.kind: /nowhere: No such file or directory"
    assert (fix, advice) == ("", "fix it before the next start")

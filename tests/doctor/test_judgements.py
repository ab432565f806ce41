"""The judgements: on a machine that is well they find nothing, and each thing that is not is found, with a remedy."""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from typing import Any

import pytest

from failstop import discovery
from failstop.api.snapshot import Client, Starved
from failstop.doctor import look as of_look
from failstop.doctor import port, stop_path
from failstop.doctor.look import FAIL, LEVELS, OK, SKIP, WARN, Look, ok
from failstop.doctor.machine import PROCESSORS, RUNTIME
from failstop.doctor.system import Holder
from failstop.doctor.table import CHECKS, examine, pasteable
from failstop.policy.settings import Settings
from tests.doctor.parts import NODE, PERSON, SERVER, SERVICE, STATE, TICKS, UNIT, but, look, on, serving
from tests.support.states import arm

UNRIGHTED = {name: but(row, realtime=False, memory_locked=False) for name, row in STATE.processes.items()}
STARVED = Starved(1, 0.07, "gate")
PORT = STATE.device
BRIDGE = Client(0, "ros2", 7, False, "no scan", "/a and /b drive", 0.1)
BRIDGED = serving(clients=(but(BRIDGE, said_s=None),))
POOR: dict[str, Any] = {"realtime": False, "limits": {resource.RLIMIT_RTPRIO: 0, resource.RLIMIT_MEMLOCK: 65536}}
REMOVED = {7: {"/dev/ttyACM0 (deleted)", "/dev/ttyACM1"}}
C10 = {f"{PROCESSORS}/cpu0/cpuidle/state3/name": "C10", f"{PROCESSORS}/cpu0/cpuidle/state3/latency": "890"}


def nodes(*users: str) -> dict[str, Any]:
    """Nodes of these users, of whom the last has the bridge, with a profile for Fast DDS."""
    owners = {f"/dev/shm/fastrtps_{user}": user for user in users}
    files = {**dict.fromkeys(owners, ""), "/proc/7/environ": "HOME=/\0FASTRTPS_DEFAULT_PROFILES_FILE=/own.xml\0"}
    return {"files": files, "owners": {**owners, "/proc/7": users[-1]}}


def answered(written: bool, answered_ms: float | None) -> Look:
    return look(stops=stop_path.judged("stop tool", written, answered_ms, "failstop doctor"))


def dead(**owners: str) -> dict[str, Any]:
    """What is left of a run of each of these names, and whose it is."""
    found = {f"/dev/shm/failstop.{name}.7.gate": owner for name, owner in owners.items()}
    return {"files": dict.fromkeys(found, ""), "owners": found}


CASES: tuple[tuple[str, Look, str, str], ...] = (
    ("port", look(node=None, device=("/", "x")), FAIL, "no serial port"),
    ("port", look(node=but(NODE, link="/dev/failstop")), WARN, "that number may be another"),
    ("identity", look(node=but(NODE, usb_id="0403:6001")), FAIL, "0403:6001"),
    ("identity", look(node=but(NODE, usb_id="")), WARN, "no USB device"),
    ("identity", look(node=but(NODE, usb_id=""), device_path="/dev/ttyACM0"), SKIP, "no USB device"),
    ("permission", look(service_user=but(SERVER, gids=frozenset({998}))), FAIL, "failstop may not open"),
    ("permission", look(node=but(NODE, accessible=False)), SKIP, "need not"),
    ("permission", look(node=but(NODE, accessible=False), service=None), WARN, "anna"),
    ("permission", look(node=but(NODE, accessible=False), service_user=None, service=None), FAIL, "anna"),
    ("holders", look(holders=((Holder(7, "python3"),), 0)), FAIL, "python3 (pid 7)"),
    ("holders", look(holders=((Holder(7, "driver", "old.service"),), 0)), FAIL, "old.service"),
    ("holders", look(holders=((Holder(7, "fs:gate", instance="left"),), 0)), FAIL, "the service 'left' has the port"),
    ("holders", look(opens=REMOVED, files=on("minicom", 7)), WARN, "/dev/ttyACM0 open from before"),
    ("holders", look(node=None, opens=REMOVED, files=on("minicom", 7)), WARN, "minicom (pid 7)"),
    ("holders", look(holders=((), 3)), WARN, "3 processes hide"),
    ("grabbers", look(files=on("ModemManager"), node=but(NODE, modem_ignored=False)), FAIL, "ModemM"),
    ("grabbers", look(files=on("ModemManager"), node=None), FAIL, "ModemM"),
    ("grabbers", look(files=on("brltty")), WARN, "brltty"),
    ("settings", look(settings=("x.toml", Settings(), "gate.lease_s = 9.0: allowed is")), FAIL, "gate.lease_s = 9.0"),
    ("deaths", look(early_news=False), WARN, "tells of a death late"),
    ("service", look(service=None), WARN, "no service named 'failstop' runs"),
    ("service", look(service=None, unit={}, others=["left"]), WARN, "there is left"),
    ("service", look(service=serving(device=but(PORT, link="deaf"))), FAIL, "does not answer"),
    ("service", look(service=serving(device=but(PORT, link="unproven"))), WARN, "not answered"),
    ("service", look(service=serving(waiting_for="the port")), WARN, "waits for the port"),
    ("service", look(service=serving(arm=arm(wrong=("it hangs",)))), WARN, "it hangs"),
    ("clients", look(service=serving(clients=(BRIDGE,))), WARN, "/a and /b drive"),
    ("ROS 2", look(**nodes("anna")), SKIP, "nodes of anna run here"),
    ("ROS 2", look(**nodes("anna", "bob"), service=BRIDGED), WARN, "Fast DDS of anna is here"),
    ("unit", look(unit={}, systemd=False), SKIP, "systemd does not run"),
    ("version", look(service=but(SERVICE, state=None, problem="is of failstop 0.0.9")), FAIL, "0.0.9"),
    ("version", look(service=but(SERVICE, version="0.0.9")), WARN, "0.0.9"),
    ("unit", look(unit={}), WARN, "does not answer"),
    ("unit", look(unit=but(UNIT, LoadState="not-found")), WARN, "no unit"),
    ("unit", look(unit=but(UNIT, LoadState="bad-setting")), FAIL, "bad-setting"),
    ("unit", look(unit=but(UNIT, ActiveState="failed", Result="watchdog")), FAIL, "watchdog"),
    ("unit", look(unit=but(UNIT, ActiveState="inactive", Result="watchdog")), FAIL, "result: watchdog"),
    ("unit", look(unit=but(UNIT, NRestarts="3")), WARN, "restarted it 3 times"),
    ("unit", look(unit=but(UNIT, ActiveState="activating", SubState="auto-restart", NRestarts="3")), FAIL, "3 times"),
    ("unit", look(unit=but(UNIT, NeedDaemonReload="yes")), WARN, "changed on disk"),
    ("unit", look(unit=but(UNIT, MainPID="4711")), WARN, "4711"),
    ("unit", look(unit=but(UNIT, UnitFileState="disabled")), WARN, "not started at boot"),
    ("realtime", look(service=serving(processes=UNRIGHTED)), WARN, "supervisor, port_owner"),
    ("realtime", look(service=serving(processes=UNRIGHTED, starved=STARVED)), WARN, "for 70 ms; the"),
    ("realtime", look(service=serving(starved=STARVED)), WARN, "for 70 ms, in spite of"),
    ("realtime", look(service=None, **POOR), WARN, "no real-time priority"),
    ("realtime", look(service=None, realtime=False), WARN, "container"),
    ("realtime", look(service=None, **POOR | {"capable": True}), WARN, "container"),
    ("realtime", look(service=None, files={RUNTIME: "0"}), FAIL, "no time at all"),
    ("memory lock", look(service=serving(processes=UNRIGHTED)), WARN, "swapped out"),
    ("memory lock", look(service=None, limits={resource.RLIMIT_MEMLOCK: (1 << 30) - 1}), WARN, "too little"),
    ("memory lock", look(service=None, **POOR), WARN, "64 KiB"),
    ("shared memory", look(room=None), FAIL, "no /dev/shm that this user may write"),
    ("shared memory", look(room=1024, service=None), FAIL, "1 KiB free"),
    ("leftovers", look(**dead(failstop="bob")), FAIL, "bob"),
    ("RemoveIPC", look(service_user=but(SERVER, uid=1001)), WARN, "logs out"),
    ("processor", look(files={f"{PROCESSORS}/cpu1/cpufreq/scaling_governor": "powersave"}), WARN, "powersave"),
    ("idle", look(files=C10), WARN, "C10 takes 890 us"),
    ("ticks", look(quick=True), SKIP, "not measured"),
    ("ticks", look(ticks=[*TICKS, (True, [1000, 41_000_000])]), FAIL, "40 ms and the lease runs out"),
    ("ticks", look(ticks=[*TICKS, (True, [1000, 6_000_000])]), WARN, "worst 6000 us"),
    ("ticks", look(ticks=[(False, [1000, 41_000_000])]), WARN, "ordinary priority"),
    ("stop path", answered(True, None), FAIL, "did not answer"),
    ("stop path", answered(False, None), FAIL, "could not be written"),
    ("stop path", answered(True, 180.0), WARN, "late"),
    ("stop path", look(stops=None, service=serving(enabled=True), stop_wanted=True), WARN, "motion is enabled"),
    ("stop path", look(stops=None), SKIP, "not tested: the service runs"),
)


def test_on_a_machine_that_is_well_every_check_says_so() -> None:
    found = examine(look())
    assert {name for name, _ in found} == CHECKS.keys()
    assert [finding for _, finding in found if finding.level != OK or finding.fix] == []


def said(given: Look, check: str) -> list[tuple[str, str, str]]:
    """(text, fix, advice) of each finding of a check."""
    return [(row.text, row.fix, row.advice) for name, row in examine(given) if name == check]


RUNS = "'failstop' runs (pid 100, user failstop), device open, the board answers"
UNIT_LINE = "LimitRTPRIO=40, as the one of failstop install"
OPENED = ((Holder(101, "fs:port_owner", "failstop.service", "failstop"),), 0)


@pytest.mark.parametrize(
    ("check", "given", "says"),
    [
        ("port", look(), "/dev/ttyACM0 (the default of device.path)"),
        ("port", look(node=but(NODE, resolved="/dev/x")), "/dev/ttyACM0, which is /dev/x (the default of device.path)"),
        ("holders", look(), "nobody has it open"),
        ("holders", look(holders=OPENED), "only the service has it open (1 processes)"),
        ("grabbers", look(), "neither ModemManager nor brltty runs"),
        ("grabbers", look(files=on("ModemManager")), "ModemManager runs and is told to leave this port alone"),
        ("service", look(), f"{RUNS}, motion disabled"),
        ("service", look(service=serving(enabled=True)), f"{RUNS}, motion enabled"),
        ("RemoveIPC", look(), "RemoveIPC is on (the default); it does not concern failstop"),
        ("idle", look(), "the slowest idle state C1 takes 2 us to wake from"),
        ("stop path", answered(True, 4.5), "stop tool: acknowledged by the board after 4.5 ms"),
    ],
)
def test_what_is_said_where_all_is_well(check: str, given: Look, says: str) -> None:
    assert [text for text, *_ in said(given, check)] == [says]


@pytest.mark.parametrize(
    ("check", "given", "fix", "advice"),
    [
        ("holders", look(holders=((Holder(7, "python3"),), 0)), "sudo kill 7", ""),
        ("holders", look(holders=((Holder(7, "x", "old.service"),), 0)), "sudo systemctl stop old.service", ""),
        ("version", look(service=but(SERVICE, version="0")), "sudo systemctl restart failstop.service", "it stops"),
        ("version", look(service=but(SERVICE, version="0"), unit={}), "sudo kill 100", "then start it again"),
        ("realtime", look(service=serving(processes=UNRIGHTED)), "", UNIT_LINE),
    ],
)
def test_the_remedy_fits_the_case(check: str, given: Look, fix: str, advice: str) -> None:
    [(_, found, besides)] = said(given, check)
    assert found == fix
    assert advice in besides


UNTOUCHED = but(NODE, accessible=False)


@pytest.mark.parametrize(
    ("changed", "why", "fix"),
    [
        ({"service": but(SERVICE, state=None)}, "the running service can't be asked", ""),
        ({"service": serving(enabled=True)}, "motion is enabled", "failstop disable --name failstop"),
        ({}, "the service runs, and would be stopped once and reset", "failstop doctor --stop-test --name failstop"),
        ({"service": None, "node": None}, "there is no port", ""),
        ({"service": None, "node": UNTOUCHED}, "this user may not open the port", ""),
        ({"service": None, "holders": ((Holder(7, "x"),), 0)}, "x (pid 7) has the port open", ""),
        (
            {"service": None, "node": but(NODE, usb_id="")},
            "/dev/ttyACM0 may not be the board, and it is not written to",
            "failstop doctor --device /dev/ttyACM0",
        ),
    ],
)
def test_where_the_stop_path_is_left_alone(changed: dict[str, Any], why: str, fix: str) -> None:
    given = look(stops=None, **changed)
    assert said(given, "stop path") == [(f"not tested: {why}", fix, "" if fix else "see to that first")]


@pytest.mark.parametrize(
    "changed",
    [{}, {"node": but(NODE, usb_id="", pseudo=True)}, {"node": but(NODE, usb_id=""), "device_path": "/dev/x"}],
)
def test_where_it_is_tried(monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any]) -> None:
    monkeypatch.setattr(stop_path, "by_hand", lambda path, _: ok(path))
    assert [text for text, *_ in said(look(stops=None, service=None, **changed), "stop path")] == [NODE.path]


@pytest.mark.parametrize(
    ("devices", "says"),
    [
        ([("/dev/ttyACM1", "x, USB 1a86:55d4")], "here there is /dev/ttyACM1"),
        ([("/dev/ttyS0", "n/a")], "no USB serial device at all"),
    ],
)
def test_a_device_that_is_not_there(monkeypatch: pytest.MonkeyPatch, devices: list[tuple[str, str]], says: str) -> None:
    monkeypatch.setattr(discovery, "candidates", lambda: devices)
    [finding] = [finding for name, finding in examine(look(node=None)) if name == "port"]
    assert finding.level == FAIL
    assert "no device /dev/ttyACM0 (the default of device.path); " in finding.text
    assert says in finding.text
    assert finding.fix


@pytest.mark.parametrize(("check", "given", "level", "says"), CASES)
def test_what_is_wrong_is_found(check: str, given: Look, level: str, says: str) -> None:
    found = [finding for name, finding in examine(given) if name == check and finding.level == level]
    assert any(says in finding.text for finding in found), examine(given)
    assert all(finding.fix or finding.advice or level == SKIP for finding in found), "every one has a remedy"
    assert all("\n" not in finding.text for finding in found)


def test_every_check_can_fail_or_warn() -> None:
    assert {check for check, *_ in CASES} == CHECKS.keys()


def test_a_service_that_runs_without_rights_is_judged_and_not_the_person_who_asks() -> None:
    given = look(**POOR)
    assert all(finding.level == OK for name, finding in examine(given) if name in ("realtime", "memory lock"))


@pytest.mark.parametrize(
    ("changed", "ignored"),
    [
        ({"systemd": False, "service_user": but(SERVER, uid=1001)}, ("RemoveIPC",)),
        ({"room": 0}, ("shared memory",)),
        ({"service": None, "limits": {resource.RLIMIT_MEMLOCK: -1}}, ("memory lock",)),
        ({"says": {"systemd-analyze": "# /x\nRemoveIPC=no\n"}, "service_user": PERSON}, ("RemoveIPC",)),
        ({"files": on("ModemManager")}, ("grabbers",)),
        ({"files": on("ModemManager"), "node": but(NODE, pseudo=True, modem_ignored=False)}, ("grabbers",)),
        ({"holders": OPENED}, ("holders",)),
        ({"node": but(NODE, pseudo=True, usb_id="")}, ("identity",)),
        (dead(failstop="failstop"), ("leftovers",)),
        ({"files": {f"{PROCESSORS}/cpu0/cpuidle/state3/disable": "1", **C10}}, ("idle",)),
        ({**nodes("anna", "bob"), "files": {"/dev/shm/fastrtps_anna": ""}, "service": BRIDGED}, ("ROS 2",)),
        ({**nodes("bob"), "service": BRIDGED}, ("ROS 2",)),
    ],
)
def test_what_is_no_fault(changed: dict[str, Any], ignored: tuple[str, ...]) -> None:
    assert [finding for name, finding in examine(look(**changed)) if name in ignored and finding.level != OK] == []


@pytest.mark.parametrize(
    ("mode", "uid", "gid", "may"),
    [
        (0o660, 998, 0, True),
        (0o060, 998, 20, False),
        (0o660, 0, 20, True),
        (0o640, 0, 20, False),
        (0o606, 0, 20, False),
        (0o606, 0, 5, True),
        (0o600, 0, 5, False),
    ],
)
def test_who_may_open_a_file(mode: int, uid: int, gid: int, may: bool) -> None:
    assert port.may_open(but(NODE, mode=mode, uid=uid, gid=gid), SERVER) == may
    assert port.may_open(but(NODE, mode=mode, uid=uid, gid=gid), but(SERVER, uid=0))


def fixes(given: Look) -> dict[str, str]:
    return {name: finding.fix for name, finding in examine(given) if finding.fix}


def test_the_gravest_comes_first() -> None:
    given = look(node=None, service=None, quick=True)
    levels = [LEVELS.index(finding.level) for _, finding in examine(given)]
    assert levels == sorted(levels, reverse=True)
    assert set(levels) == set(range(len(LEVELS)))


def test_who_is_let_into_which_group() -> None:
    def closed(**changed: Any) -> dict[str, str]:
        node = but(NODE, accessible=False, **changed)
        return fixes(look(node=node, service=None, service_user=None, user=but(PERSON, gids=frozenset())))

    assert closed()["permission"] == "sudo usermod -aG dialout anna"
    private: dict[str, Any] = {"mode": 0o600, "gid": 0, "group": "root"}
    assert closed(**private)["permission"] == "sudo failstop install"
    assert "permission" not in closed(**private, usb_id=""), "not root's group"


def test_how_a_service_that_does_not_run_is_started() -> None:
    stopped = but(UNIT, ActiveState="inactive", SubState="dead", MainPID="0")
    assert fixes(look(service=None, unit=stopped))["service"] == "sudo systemctl start failstop.service"
    assert fixes(look(service=None, unit={}))["service"] == "failstop run --device /dev/ttyACM0"
    device = ("/dev/my board", "/etc/x.toml")
    named = look("left", service=None, unit={}, device=device, settings=("/etc/x.toml", Settings(), ""))
    assert fixes(named)["service"] == "failstop run --name left --config /etc/x.toml --device '/dev/my board'"
    assert "service" not in fixes(look(service=None, unit={}, node=None)), "first the port"


def test_commands_are_such_as_the_user_can_paste() -> None:
    absent: dict[str, Any] = {"unit": but(UNIT, LoadState="not-found"), "command": "/v/fs"}
    assert fixes(look(**absent))["unit"] == "sudo /v/fs install"
    assert fixes(look(**absent, user=but(PERSON, name="root", uid=0)))["unit"] == "/v/fs install"
    assert fixes(look(quick=True, command="/v/fs"))["ticks"] == "/v/fs doctor"
    reload = but(UNIT, NeedDaemonReload="yes")
    unit = look(unit=reload, user=but(PERSON, uid=0), command="/v/failstop")
    assert fixes(unit)["unit"] == "systemctl daemon-reload"
    stop = "sudo systemctl restart failstop.service"
    assert pasteable(stop, "/v/failstop", root=False) == stop, "no command of failstop's"


def test_what_removes_what_a_dead_run_left() -> None:
    assert fixes(look(**dead(failstop="anna")))["leftovers"] == "sudo rm /dev/shm/failstop.failstop.7.*"
    assert "leftovers" not in fixes(look(**dead(left="anna"))), "another's"


def test_ticks_in_numbers() -> None:
    [(text, *_), _] = said(look(ticks=[(False, [n * 1000 for n in range(100, -1, -1)]), TICKS[1]]), "ticks")
    assert text == "woken late at ordinary priority: median 50 us, 99 % 99 us, worst 100 us of 101"


def test_how_failstop_is_called(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    own = tmp_path / "bin/failstop"
    own.parent.mkdir()
    own.touch(0o755)
    monkeypatch.setattr(sys, "executable", str(own.with_name("python3")))
    assert Look().command == str(own), "sudo does not know this path"
    monkeypatch.setattr(of_look, "SUDO_PATH", f"/usr/bin:{own.parent}")
    assert Look().command == "failstop"
    own.unlink()
    assert Look().command == f"{sys.executable} -m failstop"


def test_rights_are_granted_by_who_starts_the_service() -> None:
    for container, remedy in ((False, "prlimit --pid $$ --rtprio=40"), (True, "--cap-add SYS_NICE")):
        given = look(service=None, in_container=container, **POOR)
        (found,) = [finding for name, finding in examine(given) if name == "realtime"]
        assert remedy in found.advice
        assert bool(found.fix) is not container

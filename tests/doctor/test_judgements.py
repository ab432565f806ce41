"""The judgements: on a machine that is well they find nothing, and each thing that is not is found, with a remedy."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest

from failstop.api.snapshot import Client, Starved
from failstop.doctor import judge_port, paste
from failstop.doctor.facts import NAMED, Facts, Holder, Idle, Leftover, RemoveIpc, Ros2, StopTest, Ticks
from failstop.doctor.finding import FAIL, LEVELS, OK, SKIP, WARN, worst
from failstop.doctor.table import CHECKS, as_records, examine
from tests.doctor.parts import (
    CLOCK,
    CPU,
    MEMORY,
    NODE,
    PERSON,
    RIGHTS,
    SERVER,
    SERVICE,
    STATE,
    UNIT,
    WELL,
    but,
    facts,
    serving,
)
from tests.support.states import arm

UNRIGHTED = {name: but(row, realtime=False, memory_locked=False) for name, row in STATE.processes.items()}
STARVED = Starved(1, 0.07, "gate")
PORT = STATE.device
BRIDGE = Client(0, "ros2", 7, False, "no scan", "/a and /b drive", 0.1)
LATE = but(RIGHTS, early_news=False)
POOR = but(RIGHTS, realtime_granted=False, realtime_limit=0, memory_limit=65536)

CASES: tuple[tuple[str, Facts, str, str], ...] = (
    ("port", facts(node=None), FAIL, "no device /dev/ttyACM0"),
    ("port", facts(node=None, candidates=(("/dev/ttyACM1", "x, USB 1a86:55d4"),)), FAIL, "/dev/ttyACM1"),
    ("port", facts(node=but(NODE, character=False)), FAIL, "no serial port"),
    ("port", facts(node=but(NODE, link="/dev/failstop")), WARN, "that number may be another"),
    ("identity", facts(node=but(NODE, usb_id="0403:6001")), FAIL, "0403:6001"),
    ("identity", facts(node=but(NODE, usb_id=None)), WARN, "no USB device"),
    ("identity", facts(node=but(NODE, usb_id=None), device_origin=NAMED), SKIP, "no USB device"),
    ("permission", facts(service_user=but(SERVER, gids=frozenset({998}))), FAIL, "failstop may not open"),
    ("permission", facts(service_user=but(SERVER, gids=frozenset()), node=but(NODE, acl=True)), WARN, "ACL"),
    ("permission", facts(node=but(NODE, accessible=False)), SKIP, "need not"),
    ("permission", facts(node=but(NODE, accessible=False), service=None), WARN, "anna"),
    ("permission", facts(node=but(NODE, accessible=False), service_user=None, service=None), FAIL, "anna"),
    ("holders", facts(holders=(Holder(7, "python3"),)), FAIL, "python3 (pid 7)"),
    ("holders", facts(holders=(Holder(7, "driver", "old.service"),)), FAIL, "old.service"),
    ("holders", facts(holders=(Holder(7, "fs:gate", instance="left"),)), FAIL, "the service 'left' has the port"),
    ("holders", facts(unplugged=(Holder(7, "minicom", gone="/dev/ttyACM0"),)), WARN, "/dev/ttyACM0 open from before"),
    ("holders", facts(node=None, unplugged=(Holder(7, "minicom", gone="/dev/ttyACM0"),)), WARN, "minicom (pid 7)"),
    ("holders", facts(unseen_processes=3), WARN, "3 processes hide"),
    ("grabbers", facts(grabbers=(Holder(9, "ModemManager"),), node=but(NODE, modem_ignored=False)), FAIL, "ModemM"),
    ("grabbers", facts(grabbers=(Holder(9, "ModemManager"),), node=but(NODE, modem_ignored=None)), FAIL, "ModemM"),
    ("grabbers", facts(grabbers=(Holder(9, "brltty"),)), WARN, "brltty"),
    ("settings", facts(settings_problem="gate.lease_s = 9.0: allowed is 0.04 to 1 s"), FAIL, "gate.lease_s = 9.0"),
    ("deaths", facts(rights=LATE), WARN, "tells of a death late"),
    ("service", facts(service=None), WARN, "no service named 'failstop' runs"),
    ("service", facts(service=None, unit=None, memory=but(MEMORY, living=("left",))), WARN, "there is left"),
    ("service", facts(service=serving(device=but(PORT, link="deaf"))), FAIL, "does not answer"),
    ("service", facts(service=serving(device=but(PORT, link="unproven"))), WARN, "not answered"),
    ("service", facts(service=serving(waiting_for="the port")), WARN, "waits for the port"),
    (
        "service",
        facts(service=serving(arm=arm(wrong=("it hangs",)))),
        WARN,
        "it hangs",
    ),
    (
        "clients",
        facts(service=serving(clients=(BRIDGE,))),
        WARN,
        "/a and /b drive",
    ),
    ("ROS 2", facts(ros2=Ros2(("anna",))), SKIP, "nodes of anna run here"),
    ("ROS 2", facts(ros2=Ros2(("anna", "bob"), 7, "bob", True)), WARN, "Fast DDS of anna is here"),
    ("unit", facts(unit=None, systemd=False), SKIP, "systemd does not run"),
    ("version", facts(service=but(SERVICE, state=None, problem="is of failstop 0.0.9")), FAIL, "0.0.9"),
    ("version", facts(service=but(SERVICE, version="0.0.9")), WARN, "0.0.9"),
    ("unit", facts(unit=None), WARN, "does not answer"),
    ("unit", facts(unit=but(UNIT, load="not-found")), WARN, "no unit"),
    ("unit", facts(unit=but(UNIT, load="bad-setting")), FAIL, "bad-setting"),
    ("unit", facts(unit=but(UNIT, active="failed", result="watchdog")), FAIL, "watchdog"),
    ("unit", facts(unit=but(UNIT, active="inactive", result="watchdog")), FAIL, "result: watchdog"),
    ("memory lock", facts(service=None, rights=but(POOR, memory_limit=(1 << 30) - 1)), WARN, "too little"),
    ("clock", facts(clock=but(CLOCK, resolution_ns=1001)), FAIL, "steps of 1001"),
    ("wall clock", facts(clock=but(CLOCK, offset_s=0.5)), WARN, "0.5 s"),
    ("unit", facts(unit=but(UNIT, restarts=3)), WARN, "restarted it 3 times"),
    ("unit", facts(unit=but(UNIT, active="activating", sub="auto-restart", restarts=3)), FAIL, "3 times"),
    ("unit", facts(unit=but(UNIT, needs_reload=True)), WARN, "changed on disk"),
    ("unit", facts(unit=but(UNIT, main_pid=4711)), WARN, "4711"),
    ("unit", facts(unit=but(UNIT, enabled="disabled")), WARN, "not started at boot"),
    ("realtime", facts(service=serving(processes=UNRIGHTED)), WARN, "supervisor, port_owner"),
    ("realtime", facts(service=serving(processes=UNRIGHTED, starved=STARVED)), WARN, "for 70 ms; the"),
    ("realtime", facts(service=serving(starved=STARVED)), WARN, "for 70 ms, in spite of"),
    ("realtime", facts(service=None, rights=POOR), WARN, "no real-time priority"),
    ("realtime", facts(service=None, rights=but(POOR, realtime_limit=40)), WARN, "container"),
    ("realtime", facts(service=None, rights=but(RIGHTS, runtime_us=0)), FAIL, "no time at all"),
    ("memory lock", facts(service=serving(processes=UNRIGHTED)), WARN, "swapped out"),
    ("memory lock", facts(service=None, rights=POOR), WARN, "64 KiB"),
    ("clock", facts(clock=but(CLOCK, backward_ns=5)), FAIL, "went back by 5 ns"),
    ("clock", facts(clock=but(CLOCK, resolution_ns=4_000_000)), FAIL, "steps of 4000000"),
    ("clock", facts(clock=but(CLOCK, source="hpet")), WARN, "hpet"),
    ("clock", facts(clock=but(CLOCK, source=None, available=())), WARN, "None"),
    ("wall clock", facts(clock=but(CLOCK, synchronized=False)), WARN, "not synchronized"),
    ("wall clock", facts(clock=but(CLOCK, offset_s=-2.5)), WARN, "-2.5 s"),
    ("shared memory", facts(memory=but(MEMORY, present=False)), FAIL, "no /dev/shm"),
    ("shared memory", facts(memory=but(MEMORY, writable=False)), FAIL, "may not write"),
    ("shared memory", facts(memory=but(MEMORY, free=1024), service=None), FAIL, "1 KiB free"),
    ("leftovers", facts(memory=but(MEMORY, leftovers=(Leftover("old", 14, 4096, "x", True),))), WARN, "old (4 KiB)"),
    ("leftovers", facts(memory=but(MEMORY, leftovers=(Leftover("failstop", 14, 9, "bob", False),))), FAIL, "bob"),
    ("RemoveIPC", facts(service_user=but(SERVER, uid=1001)), WARN, "logs out"),
    ("processor", facts(cpu=but(CPU, governors=("performance", "powersave"))), WARN, "powersave"),
    ("idle", facts(cpu=but(CPU, slowest_idle=Idle("C10", 890))), WARN, "C10 takes 890 us"),
    ("ticks", facts(ticks=()), SKIP, "not measured"),
    ("wall clock", facts(clock=but(CLOCK, synchronized=None)), SKIP, "does not say"),
    ("ticks", facts(ticks=(Ticks(True, 9, 1.0, 1.0, 41_000.0),)), FAIL, "40 ms and the lease runs out"),
    ("ticks", facts(ticks=(Ticks(True, 9, 1.0, 1.0, 6_000.0),)), WARN, "worst 6000 us"),
    ("ticks", facts(ticks=(Ticks(False, 9, 1.0, 1.0, 41_000.0),)), WARN, "ordinary priority"),
    ("stop path", facts(stops=(StopTest("stop tool", True, None),)), FAIL, "did not answer"),
    ("stop path", facts(stops=(StopTest("stop tool", False, None),)), FAIL, "could not be written"),
    ("stop path", facts(stops=(StopTest("stop tool", True, 1.0, "stays latched"),)), FAIL, "stays latched"),
    ("stop path", facts(stops=(StopTest("stop tool", True, 180.0),)), WARN, "late"),
    ("stop path", facts(stops=(), stop_skipped="motion is enabled", stop_wanted=True), WARN, "motion is enabled"),
    ("stop path", facts(stops=(), stop_skipped="the service runs"), SKIP, "not tested: the service runs"),
)


def test_on_a_machine_that_is_well_every_check_says_so() -> None:
    found = examine(WELL)
    assert {name for name, _ in found} == {check.name for check in CHECKS}
    assert [finding for _, finding in found if finding.level != OK or finding.fix] == []


@pytest.mark.parametrize(("check", "given", "level", "says"), CASES)
def test_what_is_wrong_is_found(check: str, given: Facts, level: str, says: str) -> None:
    found = [finding for name, finding in examine(given) if name == check and finding.level == level]
    assert any(says in finding.text for finding in found), examine(given)
    assert all(finding.fix or finding.advice or level == SKIP for finding in found), "every one has a remedy"
    assert all("\n" not in finding.text for finding in found)


def test_every_check_can_fail_or_warn() -> None:
    assert {check for check, *_ in CASES} == {check.name for check in CHECKS}


def test_a_service_that_runs_without_rights_is_judged_and_not_the_person_who_asks() -> None:
    given = facts(rights=POOR)
    assert all(finding.level == OK for name, finding in examine(given) if name in ("realtime", "memory lock"))


@pytest.mark.parametrize(
    ("changed", "ignored"),
    [
        ({"remove_ipc": None}, ("RemoveIPC",)),
        ({"memory": but(MEMORY, free=0)}, ("shared memory",)),
        ({"service": None, "rights": but(POOR, memory_limit=-1)}, ("memory lock",)),
        ({"remove_ipc": RemoveIpc(False, "/etc/systemd/logind.conf"), "service_user": PERSON}, ("RemoveIPC",)),
        ({"grabbers": (Holder(9, "ModemManager"),)}, ("grabbers",)),
        ({"grabbers": (Holder(9, "ModemManager"),), "node": but(NODE, pseudo=True, modem_ignored=None)}, ("grabbers",)),
        ({"holders": (Holder(101, "fs:port_owner", "failstop.service", ours=True),)}, ("holders",)),
        ({"node": but(NODE, pseudo=True, usb_id=None)}, ("identity",)),
        ({"memory": but(MEMORY, leftovers=(Leftover("failstop", 14, 4096, "x", True),))}, ("leftovers",)),
    ],
)
def test_what_is_no_fault(changed: dict[str, Any], ignored: tuple[str, ...]) -> None:
    assert [finding for name, finding in examine(facts(**changed)) if name in ignored and finding.level != OK] == []


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
    assert judge_port.may_open(but(NODE, mode=mode, uid=uid, gid=gid), SERVER) == may
    assert judge_port.may_open(but(NODE, mode=mode, uid=uid, gid=gid), but(SERVER, uid=0))


def fixes(given: Facts) -> dict[str, str]:
    return {name: finding.fix for name, finding in examine(given) if finding.fix}


def test_the_gravest_comes_first() -> None:
    given = facts(node=None, service=None, ticks=(), clock=but(CLOCK, synchronized=None, source="hpet"))
    levels = [LEVELS.index(finding.level) for _, finding in examine(given)]
    assert levels == sorted(levels, reverse=True)
    assert set(levels) == set(range(len(LEVELS)))


def test_who_is_let_into_which_group() -> None:
    outside = but(PERSON, gids=frozenset())
    closed = facts(node=but(NODE, accessible=False), service=None, service_user=None, user=outside)
    assert fixes(closed)["permission"] == "sudo usermod -aG dialout anna"
    private = but(NODE, accessible=False, mode=0o600, gid=0, group="root")
    assert fixes(dataclasses.replace(closed, node=private))["permission"] == "sudo failstop install"
    assert "permission" not in fixes(dataclasses.replace(closed, node=but(private, usb_id=None))), "not root's group"


def test_how_a_service_that_does_not_run_is_started() -> None:
    stopped = but(UNIT, active="inactive", sub="dead", main_pid=0)
    assert fixes(facts(service=None, unit=stopped))["service"] == "sudo systemctl start failstop.service"
    assert fixes(facts(service=None, unit=None))["service"] == "failstop run --device /dev/ttyACM0"
    named = facts(service=None, unit=None, name="left", device="/dev/my board", settings_file="/etc/x.toml")
    assert fixes(named)["service"] == "failstop run --name left --config /etc/x.toml --device '/dev/my board'"
    assert "service" not in fixes(facts(service=None, unit=None, node=None)), "first the port"


def test_commands_are_such_as_the_user_can_paste() -> None:
    left = facts(memory=but(MEMORY, leftovers=(Leftover("old", 14, 4096, "anna", True),)))
    assert fixes(left)["leftovers"] == "failstop doctor --remove-leftovers"
    others = facts(memory=but(MEMORY, leftovers=(Leftover("old", 14, 4096, "bob", True),)), commands=("fs", "/v/fs"))
    assert fixes(others)["leftovers"] == "sudo /v/fs doctor --remove-leftovers"
    root = dataclasses.replace(others, user=but(PERSON, name="root", uid=0))
    assert fixes(root)["leftovers"] == "fs doctor --remove-leftovers"
    unit = facts(unit=but(UNIT, needs_reload=True), user=but(PERSON, uid=0), commands=("/v/failstop", "/v/failstop"))
    assert fixes(unit)["unit"] == "systemctl daemon-reload"
    stop = "sudo systemctl restart failstop.service"
    assert paste.ready(stop, "/v/failstop", "/v/failstop", root=False) == stop, "no command of failstop's"


def test_how_failstop_is_called(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    own = tmp_path / "bin/failstop"
    own.parent.mkdir()
    own.touch(0o755)
    monkeypatch.setattr(sys, "executable", str(own.with_name("python3")))
    assert paste.commands({"PATH": str(own.parent)}) == ("failstop", str(own)), "sudo does not know this path"
    assert paste.commands({"PATH": "/usr/bin"})[0] == str(own)
    own.unlink()
    assert paste.commands({"PATH": str(own.parent)})[0] == f"{sys.executable} -m failstop"


def test_the_worst_of_all() -> None:
    assert worst([]) == OK
    assert worst([OK, WARN]) == WARN
    assert worst([WARN, FAIL, OK]) == FAIL
    records = as_records(examine(facts(node=None)))
    assert worst(record["level"] for record in records) == FAIL
    assert all(
        set(record) == {"check", "level", "text", "fix", "advice"} and record["level"] in LEVELS for record in records
    )


def test_rights_are_granted_by_who_starts_the_service() -> None:
    for container, remedy in ((False, "prlimit --pid $$ --rtprio=40"), (True, "--cap-add SYS_NICE")):
        given = facts(service=None, rights=but(POOR, container=container))
        (found,) = [finding for name, finding in examine(given) if name == "realtime"]
        assert remedy in found.advice
        assert bool(found.fix) is not container

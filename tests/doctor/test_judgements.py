"""The judgements: on a machine that is well they find nothing, and each thing that is not is found, with a remedy."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.doctor import judge_port
from failstop.doctor.facts import Facts, Holder, Idle, Leftover, RemoveIpc, StopTest, Ticks
from failstop.doctor.finding import FAIL, LEVELS, OK, WARN, worst
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
    UNIT,
    WELL,
    but,
    facts,
)

UNRIGHTED = tuple(but(process, realtime=False, memory_locked=False) for process in SERVICE.processes)
POOR = but(RIGHTS, realtime_granted=False, realtime_limit=0, memory_limit=65536)

CASES: tuple[tuple[str, Facts, str, str], ...] = (
    ("port", facts(node=None), FAIL, "no device /dev/ttyACM0"),
    ("port", facts(node=None, candidates=(("/dev/ttyACM1", "x, USB 1a86:55d4"),)), FAIL, "/dev/ttyACM1"),
    ("port", facts(node=but(NODE, character=False)), FAIL, "no serial port"),
    ("identity", facts(node=but(NODE, usb_id="0403:6001")), FAIL, "0403:6001"),
    ("identity", facts(node=but(NODE, usb_id=None)), WARN, "no USB device"),
    ("permission", facts(service_user=but(SERVER, gids=frozenset({998}))), FAIL, "failstop may not open"),
    ("permission", facts(service_user=but(SERVER, gids=frozenset()), node=but(NODE, acl=True)), WARN, "ACL"),
    ("permission", facts(node=but(NODE, accessible=False)), WARN, "anna"),
    ("permission", facts(node=but(NODE, accessible=False), service_user=None, service=None), FAIL, "anna"),
    ("holders", facts(holders=(Holder(7, "python3"),)), FAIL, "python3 (pid 7)"),
    ("holders", facts(holders=(Holder(7, "driver", "old.service"),)), FAIL, "old.service"),
    ("holders", facts(unseen_processes=3), WARN, "3 processes hide"),
    ("grabbers", facts(grabbers=(Holder(9, "ModemManager"),), node=but(NODE, modem_ignored=False)), FAIL, "ModemM"),
    ("grabbers", facts(grabbers=(Holder(9, "ModemManager"),), node=but(NODE, modem_ignored=None)), FAIL, "ModemM"),
    ("grabbers", facts(grabbers=(Holder(9, "brltty"),)), WARN, "brltty"),
    ("settings", facts(settings_problem="gate.lease_s = 9.0: allowed is 0.04 to 1 s"), FAIL, "gate.lease_s = 9.0"),
    ("service", facts(service=but(SERVICE, link="deaf")), FAIL, "POWER SWITCH"),
    ("service", facts(service=but(SERVICE, link="unproven")), WARN, "not answered"),
    ("service", facts(service=but(SERVICE, waiting_for="the port")), WARN, "waits for the port"),
    ("version", facts(service=but(SERVICE, problem="is of failstop 0.0.9")), FAIL, "0.0.9"),
    ("version", facts(service=but(SERVICE, version="0.0.9")), WARN, "0.0.9"),
    ("unit", facts(unit=None), WARN, "does not answer"),
    ("unit", facts(unit=but(UNIT, load="not-found")), WARN, "no unit"),
    ("unit", facts(unit=but(UNIT, load="bad-setting")), FAIL, "bad-setting"),
    ("unit", facts(unit=but(UNIT, active="failed", result="watchdog")), FAIL, "watchdog"),
    ("unit", facts(unit=but(UNIT, restarts=3)), WARN, "restarted it 3 times"),
    ("unit", facts(unit=but(UNIT, active="activating", sub="auto-restart", restarts=3)), FAIL, "3 times"),
    ("unit", facts(unit=but(UNIT, needs_reload=True)), WARN, "changed on disk"),
    ("unit", facts(unit=but(UNIT, main_pid=4711)), WARN, "4711"),
    ("unit", facts(unit=but(UNIT, enabled="disabled")), WARN, "not started at boot"),
    ("realtime", facts(service=but(SERVICE, processes=UNRIGHTED)), WARN, "supervisor, port_owner"),
    ("realtime", facts(service=None, rights=POOR), WARN, "no real-time priority"),
    ("realtime", facts(service=None, rights=but(POOR, realtime_limit=40)), WARN, "container"),
    ("realtime", facts(service=None, rights=but(RIGHTS, runtime_us=0)), FAIL, "no time at all"),
    ("memory lock", facts(service=but(SERVICE, processes=UNRIGHTED)), WARN, "swapped out"),
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
    ("ticks", facts(ticks=(Ticks(True, 9, 1.0, 1.0, 41_000.0),)), FAIL, "40 ms and the lease runs out"),
    ("ticks", facts(ticks=(Ticks(True, 9, 1.0, 1.0, 6_000.0),)), WARN, "worst 6000 us"),
    ("ticks", facts(ticks=(Ticks(False, 9, 1.0, 1.0, 41_000.0),)), WARN, "ordinary priority"),
    ("stop path", facts(stops=(StopTest("stop tool", True, None),)), FAIL, "did not answer"),
    ("stop path", facts(stops=(StopTest("stop tool", False, None),)), FAIL, "could not be written"),
    ("stop path", facts(stops=(StopTest("stop tool", True, 1.0, "stays latched"),)), FAIL, "stays latched"),
    ("stop path", facts(stops=(StopTest("stop tool", True, 180.0),)), WARN, "late"),
    ("stop path", facts(stops=(), stop_skipped="motion is enabled", stop_wanted=True), WARN, "motion is enabled"),
)


def test_on_a_machine_that_is_well_every_check_says_so() -> None:
    found = examine(WELL)
    assert {name for name, _ in found} == {check.name for check in CHECKS}
    assert [finding for _, finding in found if finding.level != OK or finding.fix] == []


@pytest.mark.parametrize(("check", "given", "level", "says"), CASES)
def test_what_is_wrong_is_found(check: str, given: Facts, level: str, says: str) -> None:
    found = [finding for name, finding in examine(given) if name == check and finding.level == level]
    assert any(says in finding.text for finding in found), examine(given)
    assert all(finding.fix for finding in found), "every one has a remedy"
    assert all("\n" not in finding.text for finding in found)


def test_every_check_can_fail_or_warn() -> None:
    assert {check for check, *_ in CASES} == {check.name for check in CHECKS}


def test_a_service_that_runs_without_rights_is_judged_and_not_the_person_who_asks() -> None:
    given = facts(rights=POOR)
    assert all(finding.level == OK for name, finding in examine(given) if name in ("realtime", "memory lock"))


@pytest.mark.parametrize(
    ("changed", "ignored"),
    [
        ({"unit": None, "systemd": False, "remove_ipc": None}, ("unit", "RemoveIPC")),
        ({"remove_ipc": RemoveIpc(False, "/etc/systemd/logind.conf"), "service_user": PERSON}, ("RemoveIPC",)),
        ({"grabbers": (Holder(9, "ModemManager"),)}, ("grabbers",)),
        ({"grabbers": (Holder(9, "ModemManager"),), "node": but(NODE, pseudo=True, modem_ignored=None)}, ("grabbers",)),
        ({"holders": (Holder(101, "fs:port_owner", "failstop.service", ours=True),)}, ("holders",)),
        ({"stops": (), "stop_skipped": "the service runs"}, ("stop path",)),
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


def test_the_worst_of_all() -> None:
    assert worst([]) == OK
    assert worst([OK, WARN]) == WARN
    assert worst([WARN, FAIL, OK]) == FAIL
    records = as_records(examine(facts(node=None)))
    assert worst(record["level"] for record in records) == FAIL
    assert all(set(record) == {"check", "level", "text", "fix"} and record["level"] in LEVELS for record in records)

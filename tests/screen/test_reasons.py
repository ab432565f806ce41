"""Every reason that the code latches for, and every row of the fault table, has its sentence and its remedy."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import failstop
from failstop.board.interface import BOARD
from failstop.faults.table import TABLE as FAULTS
from failstop.policy.settings import Settings
from failstop.screen import reasons, verdict
from failstop.shm.layout import PROCESSES
from failstop.shm.records import REQUESTED, requested
from failstop.supervisor import aftermath

ROOT = Path(failstop.__file__).resolve().parent.parent
ANYTHING = reasons.TABLE[-1]
REQUESTS = ("asked meanwhile", "nobody says so", "flood", "hand near the wheel")
OWN = (
    *(f"{name} died" for name in PROCESSES),
    *(f"{name} hangs: 251 ms silent" for name in PROCESSES),
    *(f"{name} hangs: silent for 62 ms" for name in ("gate", "supervisor")),
    "supervisor was held up for 300 ms",
    "gate beats but sends nothing: 260 ms",
    "the machine was suspended for 1.2 s",
    "shared memory gate was removed: restart the service",
    "the stop pipe was removed: restart the service",
    "device lost",
    "port does not drain: use the POWER SWITCH",
    aftermath.DEAF_REASON,
    aftermath.UNSTILL,
    "command from nav (pid 42) is not finite",
    "multiple cmd_vel publishers: nav (pid 42), a, b (pid 43)",
    "gamepad button 0x0100",
    "key1",
    "stopped by the supervisor",
    "stopped by the supervisor (its reason is damaged)",
    "service is stopping",
)
ASKED = (
    *(f"stop request: {request} (failstop estop, pid 4711)" for request in REQUESTS),
    "stop request",
    "stop request (nav, pid 3)",
    "stop request: gate died",
)
SAMPLES = OWN + ASKED
STOPS = frozenset(("stop", "trip", "_own_stop", "Cause"))
"""Calls that take a reason to latch for."""
STAND_IN = {".0f": "62", ".1f": "1.2"}


@pytest.mark.parametrize("reason", SAMPLES)
def test_every_reason_has_a_row_of_its_own(reason: str) -> None:
    assert reasons.find(reason) is not ANYTHING
    cause, remedy = reasons.explain(reason)
    assert "{" not in cause + remedy
    assert len(cause) > 20
    assert len(remedy) > 10


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault.latched], ids=lambda fault: fault.name)
def test_every_row_of_the_fault_table_is_explained(fault: object) -> None:
    pattern = re.compile(fault.latched)  # type: ignore[attr-defined]
    fitting = [reason for reason in SAMPLES if pattern.search(reason)]
    assert fitting
    assert all(reasons.find(reason) is not ANYTHING for reason in fitting)


def _written(node: ast.expr) -> str:
    """The text that a string or f-string may give, with a stand-in for each value."""
    if isinstance(node, ast.Constant):
        return str(node.value) if isinstance(node.value, str) else ""
    parts = []
    for part in node.values if isinstance(node, ast.JoinedStr) else []:
        if isinstance(part, ast.FormattedValue):
            form = _written(part.format_spec) if part.format_spec else ""
            parts.append(STAND_IN.get(form, "gate"))
        else:
            parts.append(_written(part))
    return "".join(parts)


def _constants(tree: ast.Module) -> dict[str, ast.expr]:
    return {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def _reasons_in_code() -> set[str]:
    """The texts in the arguments of every call that latches, given there or as a constant of the module."""
    found = set()
    for folder in ("procs", "supervisor"):
        for path in (ROOT / folder).rglob("*.py"):
            tree = ast.parse(path.read_text())
            constants = _constants(tree)
            for node in ast.walk(tree):
                if not isinstance(node, ast.Call):
                    continue
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if name in STOPS:
                    given = (constants.get(arg.id, arg) if isinstance(arg, ast.Name) else arg for arg in node.args)
                    found |= {text for text in map(_written, given) if " " in text}
    return found


def test_what_the_code_latches_for_is_in_the_table() -> None:
    found = _reasons_in_code()
    assert {"device lost", "the machine was suspended for 1.2 s", aftermath.UNSTILL} <= found
    assert [reason for reason in sorted(found) if reasons.find(reason) is ANYTHING] == []


def test_what_the_board_refuses_is_a_defect() -> None:
    limit = Settings().max_wheel_rps()
    fast = BOARD.motor_speeds((9.0, 0.0, 0.0, 0.0), 10.0)
    bad_crc = fast[:-1] + bytes([fast[-1] ^ 1])
    wild = b"\xaa\x55\x03\x16\x01\x04\x07" + fast[7:-1]
    for frame in (b"", fast, bad_crc, wild + b"\0"):
        fault = BOARD.check_motion(frame, limit)
        assert fault
        assert "report it" in reasons.explain(fault)[1], fault
    assert "report it" in reasons.explain("wheel ids 7 1 2 3, must be 0 1 2 3")[1]
    assert "report it" in reasons.explain(BOARD.check_motion(fast, -1.0))[1]


def test_names_of_who_did_it() -> None:
    assert (
        'failstop estop (pid 4711) asked for a stop: "hand near"'
        in reasons.explain("stop request: hand near (failstop estop, pid 4711)")[0]
    )
    assert reasons.explain("stop request (nav, pid 3)")[0] == "nav (pid 3) asked for a stop"
    assert '"chaos"' in reasons.explain("stop request: chaos")[0]
    assert "without saying why" in reasons.explain("stop request")[0]
    assert "pressed X on the gamepad" in reasons.explain("gamepad button 0x0100")[0]
    assert "L1 and 0x0400" in reasons.explain("gamepad button 0x4400")[0]
    cause = reasons.explain("multiple cmd_vel publishers: nav (pid 42), a, b (pid 43)")[0]
    assert cause == "nav (pid 42) and a, b (pid 43) both commanded as cmd_vel"


@pytest.mark.parametrize("text", ["", "{cause}", "a\nb", "%s {0} (x, pid 9)", "gate died\x00", *OWN])
def test_whatever_somebody_writes_is_shown_as_it_is_and_as_a_request(text: str) -> None:
    cause, _ = reasons.explain(requested(text))
    assert re.match(r"somebody wrote to the stop pipe|\S.* \(pid \d+\) asked for a stop", cause)
    assert reasons.explain(text)[0]


def test_no_cause_of_the_service_s_own_looks_like_a_request() -> None:
    assert [reason for reason in {*OWN, *_reasons_in_code()} if reason.startswith(REQUESTED)] == []


def test_the_reason_of_a_contradicted_stop_is_known_as_such() -> None:
    assert verdict.UNSTILL == aftermath.UNSTILL

"""The deadman: a command that is older than its timeout moves nothing, and the gate wakes for that moment."""

from __future__ import annotations

from math import inf, nan

import pytest

from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings

from .gate_bench import MS, NO_SPEEDS, T0, Gate, stands

TIMEOUT = 300 * MS
SCAN = 500 * MS
FORWARD = (0.2, 0.0, 0.0)


@pytest.mark.parametrize(
    ("age_ns", "left_ns"), [(0, 300 * MS), (200 * MS, 100 * MS), (-3_600_000 * MS, 300 * MS)], ids=["", "old", "future"]
)
@pytest.mark.parametrize("manual", [False, True])
def test_the_deadman_counts_to_the_nanosecond_from_the_command_s_own_time(
    driving: Gate, age_ns: int, left_ns: int, manual: bool
) -> None:
    """A stamp from the future counts as now. The exemption of manual commands is from the scan gate alone."""
    assert driving.take(FORWARD, age_ns=age_ns, manual=manual) == ""
    assert driving.core.blocked(driving.now + left_ns) == ""
    assert driving.core.blocked(driving.now + left_ns + 1) == "cmd timeout"


def test_the_deadman_is_zero_at_once_and_sent_at_once_and_the_ramp_starts_from_there(driving: Gate) -> None:
    driving.take(FORWARD)
    assert driving.step(300 * MS) is not None
    assert driving.core.velocity == FORWARD
    assert driving.step(1) == NO_SPEEDS
    assert stands(driving)
    assert driving.drive(FORWARD, 1)[0][0] == pytest.approx(0.01)


def test_an_old_command_moves_nothing(gate: Gate) -> None:
    gate.enable()
    assert gate.take(FORWARD, age_ns=301 * MS) == ""
    gate.step()
    assert gate.blocked == "cmd timeout"
    assert stands(gate)


def test_the_deadman_s_time_is_the_setting_s() -> None:
    gate = Gate(gate__command_timeout_s=0.5)
    gate.enable()
    gate.take(FORWARD)
    assert gate.core.blocked(gate.now + 500 * MS) == ""
    assert gate.core.blocked(gate.now + 500 * MS + 1) == "cmd timeout"


@pytest.mark.claim("CLIENT-1")
@pytest.mark.parametrize("value", [0, -1, 0.049, 2.01, inf, nan, "off", "", False, None])
def test_the_deadman_cannot_be_switched_off(value: object) -> None:
    """No value means never: from 0.05 to 2 s are allowed, and of each source's own timeout too."""
    for key in ("gate.command_timeout_s", "sources.cmd_vel.timeout_s", "sources.teleop.timeout_s"):
        with pytest.raises(SettingError, match=f"^{key} = .*0.05 to 2 s"):
            Settings({key: value})


# When the gate has to look again although nothing is new: when what drives stops counting.


def due_ns(gate: Gate) -> int | None:
    return gate.core.due_ns(gate.now)


def scanned(*, manual: bool = False) -> Gate:
    """Commanded now, and the obstacle sensor's last delivery counts for 100 ms more."""
    gate = Gate(scan__gate="on")
    gate.enable()
    gate.core.scan.deliver(T0 - SCAN + 100 * MS, T0)
    assert gate.command(0.1, manual=manual) == ""
    return gate


def test_nothing_is_due_without_a_command_or_while_disabled(gate: Gate) -> None:
    assert gate.command(0.1) == ""
    assert due_ns(gate) is None
    gate.enable()
    assert due_ns(gate) is None


def test_a_command_is_due_at_its_timeout_and_the_wheels_stop_in_that_step(gate: Gate) -> None:
    gate.enable()
    assert gate.command(0.1) == ""
    assert gate.step() is not None
    assert due_ns(gate) == T0 + TIMEOUT + 1
    assert gate.step(TIMEOUT + 1 - 20 * MS) == NO_SPEEDS
    assert gate.blocked == "cmd timeout"
    assert due_ns(gate) is None, "or the loop would spin"


def test_the_sensor_is_due_when_it_comes_first_and_counts() -> None:
    gate = scanned()
    assert due_ns(gate) == T0 + 100 * MS + 1
    gate.now += 100 * MS
    assert gate.blocked == ""
    gate.now += 1
    assert gate.blocked == "no scan"
    assert due_ns(gate) is None
    assert due_ns(scanned(manual=True)) == T0 + TIMEOUT + 1

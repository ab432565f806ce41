"""The deadman: a command that is older than the command timeout moves nothing. Integers for a clock."""

from __future__ import annotations

from math import inf, nan

import pytest

from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.procs.gate.core import NO_SPEEDS

from .gate_bench import MS, Gate, stands


def test_no_command_yet_is_a_timeout(gate: Gate) -> None:
    gate.enable()
    assert gate.blocked == "cmd timeout"


def test_the_deadman_is_exact(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0)) == ""
    assert driving.core.blocked(driving.now + 300 * MS) == ""
    assert driving.core.blocked(driving.now + 300 * MS + 1) == "cmd timeout"


def test_the_deadman_is_zero_at_once_and_sent_at_once(driving: Gate) -> None:
    driving.take((0.2, 0.0, 0.0))
    assert driving.step(300 * MS) is not None
    assert driving.core.velocity == (0.2, 0.0, 0.0)
    assert driving.step(1) == NO_SPEEDS
    assert stands(driving)


def test_the_deadman_counts_from_the_command_s_own_time(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0), age_ns=200 * MS) == ""
    assert driving.core.blocked(driving.now + 100 * MS) == ""
    assert driving.core.blocked(driving.now + 100 * MS + 1) == "cmd timeout"


def test_an_old_command_moves_nothing(gate: Gate) -> None:
    gate.enable()
    assert gate.take((0.2, 0.0, 0.0), age_ns=301 * MS) == ""
    gate.step()
    assert gate.blocked == "cmd timeout"
    assert stands(gate)


def test_a_stamp_from_the_future_counts_as_now(driving: Gate) -> None:
    assert driving.take((0.2, 0.0, 0.0), age_ns=-3_600_000 * MS) == ""
    assert driving.core.blocked(driving.now + 300 * MS + 1) == "cmd timeout"


def test_the_deadman_s_time_is_the_setting_s() -> None:
    gate = Gate(gate__command_timeout_s=0.5)
    gate.enable()
    gate.take((0.2, 0.0, 0.0))
    assert gate.core.blocked(gate.now + 500 * MS) == ""
    assert gate.core.blocked(gate.now + 500 * MS + 1) == "cmd timeout"


def test_after_the_deadman_the_ramp_starts_from_zero(driving: Gate) -> None:
    driving.step(301 * MS)
    assert stands(driving)
    assert driving.drive((0.2, 0.0, 0.0), 1)[0][0] == pytest.approx(0.01)


@pytest.mark.parametrize("value", [0, -1, 0.049, 2.01, inf, nan, "off", "", False, None])
def test_the_deadman_cannot_be_switched_off(value: object) -> None:
    """No value means never: from 0.05 to 2 s are allowed, and of each source's own timeout too."""
    for key in ("gate.command_timeout_s", "sources.cmd_vel.timeout_s", "sources.teleop.timeout_s"):
        with pytest.raises(SettingError, match=f"^{key} = .*0.05 to 2 s"):
            Settings({key: value})


def test_a_manual_command_times_out_too(gate: Gate) -> None:
    """The exemption of manual commands is from the scan gate alone."""
    gate.enable()
    assert gate.command(0.2, manual=True) == ""
    assert gate.core.blocked(gate.now + 300 * MS) == ""
    assert gate.core.blocked(gate.now + 300 * MS + 1) == "cmd timeout"

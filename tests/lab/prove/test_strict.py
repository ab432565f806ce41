"""Robots with stricter settings than the defaults, which latch more and ask for an operator: they pass too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from failstop.supervisor import status
from failstop_lab.prove.session import until_valid
from failstop_lab.trial import write_settings
from tests.lab.prove.judged import firm
from tests.lab.prove.kiwi import beside, standing
from tests.support.commands import failstop

LIMIT_S = 240
STRICT = {"gate.driver_silence": "latch", "gate.driver_death": "latch", "attend.required": "on"}


@pytest.mark.slow
def test_what_a_silent_driver_latches_is_wanted_and_somebody_attends(tmp_path: Path) -> None:
    """The battery and the gamepad of the simulated board hinder nobody."""
    settings = tmp_path / "strict.toml"
    more = {"attend.lease_s": 0.5, "battery.stop_mv": 20_000, "pad.mode_button": 0x0100}
    write_settings(str(settings), {**STRICT, **more, status.LEASE: status.LEASE_WITHOUT_S})
    words = ("--only", "timeout,scan,pad", "--at", "0.2", "--config", str(settings))
    done = failstop("prove", "--sim", "--json", *words, timeout=LIMIT_S)
    result = json.loads(done.stdout)
    rows = {row["path"]: row for row in result["rows"]}
    assert (tuple(rows), result["ended"]) == (("timeout", "scan", "pad"), ""), done.stderr
    assert [firm(row["wrong"]) for row in rows.values()] == [[]] * len(rows), done.stderr
    assert rows["timeout"]["latched"].startswith("driver silent: prove")
    assert rows["scan"]["latched"] is None
    assert not rows["pad"]["skipped"]


@pytest.mark.slow
def test_what_a_lost_driver_latches_beside_the_arm_is_wanted(tmp_path: Path) -> None:
    with standing(tmp_path, **STRICT) as kiwi:
        for name, latched in (("arm-client-killed", "driver died: "), ("arm-client-hung", "driver silent: ")):
            result = until_valid(beside(kiwi, name).perform, lambda _: None)
            assert firm(result.wrong) == [], name
            assert str(result.latched).startswith(f"{latched}prove arm"), name


@pytest.mark.slow
def test_a_driver_that_hangs_beside_the_arm_has_not_died(tmp_path: Path) -> None:
    """The test ends the program that it has suspended, which must not look as if the robot had stopped for its
    death."""
    with standing(tmp_path, **{**STRICT, "gate.driver_silence": "wait"}) as kiwi:
        result = until_valid(beside(kiwi, "arm-client-hung").perform, lambda _: None)
        assert firm(result.wrong) == []
        assert result.latched is None

"""Faults that a run of `failstop prove` must call wrong, without a stand: each alone."""

from __future__ import annotations

import pytest

from failstop.lab.prove import table
from failstop.lab.prove.table import BY_PATH
from failstop.policy import causes
from failstop.policy.causes import Cause
from tests.prove.judged import MS, run, wrong
from tests.prove.noise import DRIVE, gyro
from tests.support.board_events import FAULT_NS, event
from tests.support.board_events import STILL as REST


def test_all_is_well() -> None:
    assert wrong(run()) == []


def test_what_the_imu_does_not_show_is_not_proved() -> None:
    made = run()
    made.stand.watch.samples = gyro((1.0, DRIVE), bias=0.0, start_ns=FAULT_NS - 1_000 * MS)
    assert wrong(made) == ["the IMU is silent"]
    assert (made.result.verdict, made.result.runaway, made.result.rest_s) == ("FAIL", True, None)


def test_a_stop_that_is_late_at_the_board() -> None:
    bar_ms = BY_PATH["stop-request"].reaction_bar_ms(simulated=True)
    assert wrong(run(events=[event(0, bar_ms - 0.1, REST)])) == []
    assert wrong(run(events=[event(0, bar_ms + 0.1, REST)]))[0].startswith("at the board after")


@pytest.mark.parametrize("latch", [None, causes.KEY(1), causes.PIPED("another"), causes.DIED("prove")])
def test_another_latch(latch: Cause | None) -> None:
    assert wrong(run(latch=latch)) == [f"latched: {latch}, not piped prove"]


def test_an_acknowledgement_that_is_late() -> None:
    made = run()
    late_ns = FAULT_NS + round((table.ACKNOWLEDGED_MS + 2) * MS)
    made.stand.watch.answers = [(FAULT_NS + 2 * MS, late_ns)]
    assert wrong(made) == ["acknowledged after 1002 ms"]


def test_a_service_that_ends_badly() -> None:
    made = run("service-stop")
    made.check_end()
    assert made.result.wrong == ["the service ended with exit code 3"]

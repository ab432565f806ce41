"""Wheels that turn while motion is enabled and nobody commands anything: when the gate disables motion for it."""

from __future__ import annotations

import pytest

from failstop.messages import records
from failstop.procs.gate.turning import TurningWatch

MS = 1_000_000
AFTER_NS = 1500 * MS
NO_SPEEDS = (0.0,) * 8


class Seen:
    """Telemetry's record, as the test says."""

    def __init__(self) -> None:
        self.entry: tuple[int, int, bytes] | None = None

    def read(self) -> tuple[int, int, bytes] | None:
        return self.entry

    def say(self, t_ns: int, *, by: str = "wheels", unexpected: bool = True) -> None:
        head = (records.WHEELS_DO.index("turning"), records.WHEELS_BY.index(by), unexpected, 2, 1, 1)
        self.entry = 1, t_ns, records.WHEELS_SEEN.pack(*head, *NO_SPEEDS)


def first_ns(seen: Seen, *, by: str = "wheels", unexpected: bool = True, driven_until_ns: int = 0) -> int:
    """When it is disabled, of looks every 20 ms from 20 ms on; 0: never within 5 s."""
    turning = TurningWatch(seen, AFTER_NS)  # type: ignore[arg-type]
    for now_ns in range(20 * MS, 5000 * MS, 20 * MS):
        seen.say(now_ns - 5 * MS, by=by, unexpected=unexpected)
        if turning.check(now_ns, idle=now_ns > driven_until_ns):
            return now_ns
    return 0


def test_reports_of_wheels_that_turn_although_told_zero_disable_motion() -> None:
    assert AFTER_NS <= first_ns(Seen()) <= AFTER_NS + 60 * MS


def test_the_time_counts_from_the_end_of_a_drive() -> None:
    assert first_ns(Seen(), driven_until_ns=2000 * MS) >= 2000 * MS + AFTER_NS


@pytest.mark.parametrize(("by", "unexpected"), [("IMU", True), ("wheels", False)])
def test_what_an_imu_feels_and_wheels_that_still_may_turn_disable_nothing(by: str, unexpected: bool) -> None:
    assert first_ns(Seen(), by=by, unexpected=unexpected) == 0


def test_a_record_from_before_is_about_other_commands() -> None:
    seen = Seen()
    turning = TurningWatch(seen, AFTER_NS)  # type: ignore[arg-type]
    seen.say(1000 * MS)
    assert not any(turning.check(now_ns, idle=True) for now_ns in range(20 * MS, 5000 * MS, 20 * MS))

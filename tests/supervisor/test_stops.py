"""The last stop's three levels: written, acknowledged, observed."""

from __future__ import annotations

import pytest

from failstop.supervisor.children import Fence
from failstop.supervisor.stops import ACKNOWLEDGE_NS, JUDGED_AFTER_NS, JUDGED_WITHIN_NS, Stop, still_after
from tests.support.why import why

MS = 1_000_000
T0 = 10_000 * MS
AFTER = 1_500 * MS


def stop(written_ms: float = 0.5) -> Stop:
    written_ns = T0 + round(written_ms * MS) if written_ms else 0
    found = Stop(T0, "gate", why("gate died"))
    found.answered_by("port owner", written_ns, found, 2)
    found.follow(AFTER, 1.0)
    return found


def test_written() -> None:
    record = stop().as_record()
    assert record["written_us"] == 500.0
    assert record["acknowledged_us"] is None
    assert record["observed_ms"] is None
    assert stop(0).as_record()["written_us"] is None


def test_a_ping_from_before_the_stop_proves_nothing() -> None:
    last = stop()
    assert not last.ponged(T0 + MS // 2 - 1, T0 + 2 * MS)
    assert last.ponged(T0 + MS // 2, T0 + 3 * MS)
    assert last.as_record()["acknowledged_us"] == 3_000.0
    assert not last.ponged(T0 + 5 * MS, T0 + 6 * MS), "the first answer counts"


def test_what_was_not_written_is_not_acknowledged() -> None:
    assert not stop(0).ponged(T0 + 100 * MS, T0 + 101 * MS)


def test_wheels_that_come_to_rest() -> None:
    last = stop()
    for ms in range(0, 900, 10):
        assert not last.judged(0, T0 + ms * MS, T0 + ms * MS)
    assert not last.judged(T0 + 380 * MS, T0 + 900 * MS, T0 + 900 * MS)
    assert last.as_record()["observed_ms"] == 380.0
    assert "wheels still after about 0.4 s" in last.outcome("alive")


def test_the_judgement_from_before_the_stop_does_not_count() -> None:
    last = stop()
    still_ns = T0 - 5_000 * MS
    assert not last.judged(still_ns, T0 + JUDGED_AFTER_NS - 1, T0 + JUDGED_AFTER_NS)
    assert last.observed_ns is None
    last.judged(still_ns, T0 + JUDGED_AFTER_NS, T0 + JUDGED_AFTER_NS)
    assert last.observed_ns == 0
    assert "no shaking seen" in last.outcome("alive")


def test_a_supervisor_that_was_held_up_takes_the_imu_s_word_for_what_it_missed() -> None:
    last = stop()
    assert not last.judged(T0 + 150 * MS, T0 + 700 * MS, T0 + 705 * MS)
    assert last.as_record()["observed_ms"] == 150.0


def test_wheels_that_stood_while_the_supervisor_was_held_up_did_not_shake() -> None:
    last = stop()
    last.judged(T0 - 5_000 * MS, T0 + 900 * MS, T0 + 905 * MS)
    assert last.observed_ns == 0


def test_a_verdict_that_only_began_anew_is_no_shaking() -> None:
    """Telemetry that was restarted judges from its own start on; the supervisor looked all the while."""
    last = stop()
    assert not last.judged(T0 - 5_000 * MS, T0 - 10 * MS, T0 + 5 * MS)
    last.judged(T0 + 200 * MS, T0 + 900 * MS, T0 + 905 * MS)
    assert last.observed_ns == 0


def test_wheels_that_do_not_come_to_rest_are_a_cause_again_and_again() -> None:
    last = stop()
    found = [ms for ms in range(0, 4_000, 20) if last.judged(0, T0 + ms * MS, T0 + ms * MS)]
    assert found == [1_500, 3_000]
    assert "NOT seen still" in last.outcome("alive")


@pytest.mark.parametrize("still_ns", [0, T0 + 400 * MS])
def test_a_silent_imu_judges_nothing(still_ns: int) -> None:
    last = stop()
    judged_ns = T0 + 1_600 * MS
    assert not last.judged(still_ns, judged_ns, judged_ns + JUDGED_WITHIN_NS + 1)
    assert last.observed_ns is None


def test_a_stop_that_could_be_written_only_later_is_proven_from_then_on() -> None:
    last = stop(0)
    assert last.complete(T0 + AFTER + JUDGED_WITHIN_NS)
    back_ns = T0 + 5_000 * MS
    last.written_at_last(back_ns, "port owner")
    assert last.as_record()["written_us"] == 5_000_000.0
    assert not last.ponged(back_ns - 1, back_ns + MS)
    assert not last.judged(0, back_ns + 1_400 * MS, back_ns + 1_400 * MS), "the wheels have their time from then"
    assert last.judged(0, back_ns + AFTER, back_ns + AFTER)
    assert last.ponged(back_ns, back_ns + 3 * MS)
    assert last.complete(back_ns + AFTER), "and it is told again"


def test_it_is_told_once_when_all_is_known() -> None:
    last = stop()
    last.ponged(T0 + MS, T0 + 2 * MS)
    assert not last.complete(T0 + 900 * MS)
    last.judged(0, T0 + 500 * MS, T0 + 500 * MS)
    last.judged(T0 + 300 * MS, T0 + 1_000 * MS, T0 + 1_000 * MS)
    assert last.complete(T0 + 1_000 * MS)
    assert not last.complete(T0 + 1_020 * MS)
    assert last.outcome("alive") == "gate died: acknowledged by the board after 2.0 ms, wheels still after about 0.3 s"


def test_it_is_told_at_last_without_answer_and_without_imu() -> None:
    last = stop()
    assert not last.complete(T0 + AFTER)
    assert last.complete(T0 + AFTER + JUDGED_WITHIN_NS)
    assert last.outcome("unproven") == "gate died: not acknowledged (link unproven), not observed"


def test_what_the_kernel_still_holds_is_not_said_to_be_sent() -> None:
    last = stop()
    last.held = True
    assert last.outcome("deaf") == "gate died: handed over, NOT sent: the board takes no bytes, not observed"
    assert last.fields("deaf")["sent"] is False
    assert last.as_record()["sent"] is False
    assert last.ponged(T0 + MS, T0 + 2 * MS), "it takes them again"
    assert last.as_record()["sent"] is True


def test_a_rest_within_the_resolution_is_told_as_that() -> None:
    assert still_after(0.19) == "less than 0.2 s"
    assert still_after(0.2) == "about 0.2 s"
    assert still_after(1.25) == "about 1.2 s"


def test_what_programs_are_told_of_it() -> None:
    last = stop()
    told = {"reason": "gate died", "cause": "died", "epoch": 2, "link": "alive", "sent": True}
    assert last.fields("alive") == {**told, "acknowledged_us": None, "observed_ms": None, "wheels": "unknown"}
    assert last.ponged(T0 + MS, T0 + 2 * MS)
    last.judged(0, T0 + AFTER, T0 + AFTER)
    assert last.fields("alive") == {**told, "acknowledged_us": 2_000.0, "observed_ms": None, "wheels": "unstill"}
    last.judged(T0 + 2 * AFTER - 1, T0 + 2 * AFTER, T0 + 2 * AFTER)
    observed_ms = (2 * AFTER - 1) / 1e6
    assert last.fields("alive") == {**told, "acknowledged_us": 2_000.0, "observed_ms": observed_ms, "wheels": "still"}
    assert last.as_record() == {
        "cause": why("gate died").pack(),
        "latched": why("gate died").pack(),
        "noticed_by": "gate",
        "written_by": "port owner",
        "t": 1.0,
        "epoch": 2,
        "sent": True,
        "written_us": 500.0,
        "acknowledged_us": 2_000.0,
        "observed_ms": observed_ms,
    }


def test_a_stop_from_before_its_cause_was_written_at_once() -> None:
    assert stop(-0.5).as_record()["written_us"] == 0.0


def test_one_that_is_observed_waits_a_while_for_its_acknowledgement() -> None:
    last = stop()
    last.judged(T0 - 5_000 * MS, T0 + JUDGED_AFTER_NS, T0 + JUDGED_AFTER_NS)
    assert not last.complete(T0 + ACKNOWLEDGE_NS - 1)
    assert last.complete(T0 + ACKNOWLEDGE_NS)


def test_a_fence_tells_its_times_in_order() -> None:
    fence = Fence(T0, T0 + MS // 10, T0 + MS // 5)
    assert fence.story("port_owner") == "port_owner was fenced: killed after 0.1 ms, stop written after 0.2 ms"
    fence.gone(T0 + MS, T0 + 2 * MS)
    assert fence.story("port_owner") == (
        "port_owner was fenced: killed after 0.1 ms, stop written after 0.2 ms, "
        "gone after 1.0 ms, stop again after 2.0 ms"
    )
    assert fence.fields() == {
        "silent_ms": 0.0,
        "kill_us": 100.0,
        "burst_us": 200.0,
        "gone_us": 1000.0,
        "again_us": 2000.0,
    }
    assert not fence.was_starved
    gate = Fence(T0, T0 + MS, 0, 61_250_001)
    gate.gone(T0 + 200 * MS, 0)
    assert gate.story("gate") == "gate was fenced: killed after 1.0 ms, gone after 200.0 ms"
    assert gate.fields() == {"silent_ms": 61.3, "kill_us": 1000.0, "gone_us": 200000.0}

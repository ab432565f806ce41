"""The first cause since the last reset is the one that is latched, and a reset clears it and nothing else."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.policy import causes
from failstop.supervisor.latch import Latch
from failstop.supervisor.stops import Stop
from tests.support.why import said, told, why

MS = 1_000_000


def stop(text: str, t_ns: int = 100) -> Stop:
    return Stop(t_ns, "port_owner", why(text))


def latched(latch: Latch) -> str | None:
    return said(latch.stop.cause) if latch.stop else None


def test_who_asked_before_the_last_stop_did_not_know_of_it() -> None:
    latch = Latch()
    latch.add([stop("key1")], 2, 110)
    latch.add([stop("gate died")], 3, 200)
    assert told(latch.reset(3, 199)) == (False, "asked before the last stop (gate died): see to that, then ask again")
    assert latched(latch) == "key1"
    assert latch.reset_epoch == 0
    assert latch.reset(3, 200).done


def test_a_later_request_of_one_program_completes_the_cause_once() -> None:
    lacking = causes.REQUESTED(f"two drive: /nav, a node whose name is {causes.NOT_KNOWN}", "ros2", 77)
    whole = causes.REQUESTED("two drive: /nav, /joy", "ros2", 77)
    latch = Latch()
    latch.add([Stop(100, "port_owner", lacking)], 2, 110)
    latch.add([Stop(120, "port_owner", causes.REQUESTED("two drive: /nav, /mallory", "mallory", 78))], 3, 130)
    assert latch.stop is not None
    assert latch.stop.cause == lacking, "another program's words are its own"
    latch.add([stop("key1", 140), Stop(150, "port_owner", whole)], 4, 160)
    assert (latch.stop.cause, latch.stop.t_ns, latch.since) == (whole, 100, 2)
    assert records.LATCH.unpack(latch.as_record()) == (2, 100, 160, whole.pack())
    latch.add([Stop(170, "port_owner", causes.REQUESTED("two drive: /nav, /third", "ros2", 77))], 5, 180)
    assert latch.stop.cause == whole


def test_what_everybody_reads() -> None:
    latch = Latch()
    latch.add([stop("key1", 100)], 2, 110)
    latch.add([stop("gate died", 150)], 3, 160)
    assert records.LATCH.unpack(latch.as_record()) == (2, 100, 160, causes.KEY(1).pack())
    latch.reset(3, 170)
    assert records.LATCH.unpack(latch.as_record()) == (0, 150, 160, causes.DIED("gate").pack()), "the last stop"


@pytest.mark.claim("CAUSE-1")
@given(st.lists(st.tuples(st.booleans(), st.lists(st.integers(0, 1000), min_size=1, max_size=4)), max_size=20))
@example([(False, [300, 100, 200]), (False, [50]), (True, [7]), (False, [6])])
@example([(True, [1]), (True, [2])])
def test_the_first_noticed_of_those_that_came_first_is_latched(history: list[tuple[bool, list[int]]]) -> None:
    """Each step: was there a reset before it, and the times of the stops that come together."""
    latch = Latch()
    expected, since = None, 0
    for epoch, (reset, times) in enumerate(history, start=2):
        now_ns = epoch * 10_000
        if reset:
            assert told(latch.reset(epoch - 1, now_ns)) == (True, answer(expected))
            assert (latched(latch), latch.since, latch.reset_epoch) == (None, 0, epoch - 1)
            expected = None
        latch.add([Stop(t_ns, "gate", why(f"{epoch}:{t_ns}")) for t_ns in times], epoch, now_ns)
        first = f"{epoch}:{min(times)}"
        expected, since = (expected, since) if expected else (first, epoch)
        assert (latched(latch), latch.since) == (expected, since), "even when a later one was noticed sooner"
        assert said(latch.newest.cause if latch.newest else None) == first


def answer(was: str | None) -> str:
    """The reply to a reset of this stop, or of none."""
    if not was:
        return "no stop is latched"
    return f"latched stop cleared (was: {why(was)}); motion still disabled"

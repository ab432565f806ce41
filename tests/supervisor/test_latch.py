"""The first cause since the last reset is the one that is latched, and a reset clears it and nothing else."""

from __future__ import annotations

from hypothesis import given
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


def test_the_first_stays() -> None:
    latch = Latch()
    latch.add([stop("key1")], 2, 110)
    latch.add([stop("gate died", 50)], 3, 120)
    assert latched(latch) == "key1", "even when a later one was noticed sooner"
    assert latch.since == 2
    assert latch.newest is not None
    assert said(latch.newest.cause) == "gate died"


def test_of_those_that_come_together_the_one_noticed_first() -> None:
    latch = Latch()
    latch.add([stop("supervisor's", 300), stop("port owner's", 100), stop("gate's", 200)], 2, 400)
    assert latched(latch) == "port owner's"


def test_after_a_reset_the_next_is_latched() -> None:
    latch = Latch()
    latch.add([stop("key1")], 2, 110)
    assert told(latch.reset(2, 111)) == (True, "latched stop cleared (was: key1); motion still disabled")
    assert (latched(latch), latch.since, latch.reset_epoch) == (None, 0, 2)
    latch.add([stop("gate died")], 3, 120)
    assert (latched(latch), latch.since) == ("gate died", 3)


def test_who_asked_before_the_last_stop_did_not_know_of_it() -> None:
    latch = Latch()
    latch.add([stop("key1")], 2, 110)
    latch.add([stop("gate died")], 3, 200)
    assert told(latch.reset(3, 199)) == (False, "asked before the last stop (gate died): see to that, then ask again")
    assert latched(latch) == "key1"
    assert latch.reset_epoch == 0
    assert latch.reset(3, 200).done


def test_a_reset_with_nothing_latched_changes_nothing_and_is_one_all_the_same() -> None:
    latch = Latch()
    assert told(latch.reset(1, 5)) == (True, "no stop is latched")
    assert latch.reset(1, 5).cause is None
    assert (latched(latch), latch.since, latch.reset_epoch) == (None, 0, 1)


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


@given(st.lists(st.tuples(st.booleans(), st.lists(st.integers(0, 1000), min_size=1, max_size=4)), max_size=20))
def test_any_history(history: list[tuple[bool, list[int]]]) -> None:
    """Each step: was there a reset before it, and the times of the stops that come together."""
    latch = Latch()
    expected = None
    for epoch, (reset, times) in enumerate(history, start=2):
        now_ns = epoch * 10_000
        if reset:
            assert latch.reset(epoch - 1, now_ns).done
            expected = None
        latch.add([Stop(t_ns, "gate", why(f"{epoch}:{t_ns}")) for t_ns in times], epoch, now_ns)
        expected = expected or f"{epoch}:{min(times)}"
        assert latched(latch) == expected

"""A stop: who wrote it, and the cause that it is told with."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop.messages import layout, records
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.supervisor.latch import Latch
from failstop.supervisor.stops import SOONER_NS, Stop, explained
from tests.support.why import said, told, why

T = 10**12
"""When the cause was noticed."""
WRITTEN = T + 50_000
MS = 1_000_000
OWN, OTHER, GATE = layout.PORT_OWNER, layout.SUPERVISOR, layout.GATE
TO_WRITE = ("supervisor", 0)


@pytest.mark.parametrize(
    ("noticed_by", "written_ns", "answered", "may_answer", "port_owner_ns", "told"),
    [
        # It may still answer, whatever is known so far.
        (OWN, WRITTEN, False, True, WRITTEN, None),
        (OTHER, WRITTEN, False, True, 0, None),
        (GATE, 0, False, True, WRITTEN, None),
        # The cause came with its stop: by who noticed it, whether or not the epoch was answered too.
        (OWN, WRITTEN, True, True, WRITTEN, ("port owner", WRITTEN)),
        (OWN, WRITTEN, False, False, WRITTEN, ("port owner", WRITTEN)),
        (OTHER, WRITTEN, False, False, 0, ("supervisor", WRITTEN)),
        (OTHER, WRITTEN, True, False, WRITTEN + 1, ("supervisor", WRITTEN)),
        # Nobody has written, and the port owner will not.
        (OWN, 0, False, False, WRITTEN, TO_WRITE),
        (OTHER, 0, False, False, WRITTEN, TO_WRITE),
        (GATE, 0, False, False, WRITTEN, TO_WRITE),
        # It could not write for its own cause; what it wrote before is none for it.
        (OWN, 0, True, True, T - 1, TO_WRITE),
        # Its answer to somebody else's cause; it may have noticed that cause itself a little sooner.
        (GATE, 0, True, True, WRITTEN, ("port owner", WRITTEN)),
        (OTHER, 0, True, False, T - SOONER_NS, ("port owner", T - SOONER_NS)),
        # And an answer without a burst: it has no port.
        (GATE, 0, True, True, T - SOONER_NS - 1, TO_WRITE),
        (OTHER, 0, True, True, 0, TO_WRITE),
    ],
)
def test_table(
    noticed_by: str, written_ns: int, answered: bool, may_answer: bool, port_owner_ns: int, told: tuple[str, int] | None
) -> None:
    cause = Stop(T, noticed_by, why("x"), written_ns)
    assert cause.who_wrote(answered=answered, may_answer=may_answer, port_owner_ns=port_owner_ns) == told


def test_a_time_is_told_with_who_wrote_then() -> None:
    """In every case: a time that only the port owner can have is its own, and the other way round."""
    times = (0, T - SOONER_NS - 1, T + 1)
    for by, answered, may, port_owner_ns in itertools.product((OWN, OTHER), (True, False), (True, False), times):
        for written_ns in (0, WRITTEN):
            stop = Stop(T, by, why("x"), written_ns)
            told = stop.who_wrote(answered=answered, may_answer=may, port_owner_ns=port_owner_ns)
            if told and told[1]:
                of_port_owner = (by == OWN) if told[1] == WRITTEN else True
                assert told[0] == ("port owner" if of_port_owner else "supervisor")
            assert (told is None) == (may and not answered)


@pytest.mark.parametrize(
    ("cause", "suspended_ns", "told"),
    [
        (causes.HANGS(layout.SUPERVISOR, 61), 2_500 * MS, causes.SUPERVISOR_SUSPENDED(2.5)),
        (causes.HELD_UP(2500), 2_500 * MS, causes.SUPERVISOR_SUSPENDED(2.5)),
        (causes.HANGS(layout.SUPERVISOR, 61), 0, causes.HANGS(layout.SUPERVISOR, 61)),
        (causes.HANGS(layout.GATE, 61), 2_500 * MS, causes.HANGS(layout.GATE, 61)),
        (causes.DIED(layout.SUPERVISOR), 2_500 * MS, causes.DIED(layout.SUPERVISOR)),
    ],
)
def test_what_a_supervisor_knows_of_its_own_silence(cause: Cause, suspended_ns: int, told: Cause) -> None:
    assert explained(cause, suspended_ns) == told


# The first cause since the last reset is latched, and a reset clears it and nothing else.


def stop(text: str, t_ns: int = 100) -> Stop:
    return Stop(t_ns, "port_owner", why(text))


def latched(latch: Latch) -> str | None:
    return said(latch.stop.cause) if latch.stop else None


def test_who_asked_before_the_last_stop_did_not_know_of_it() -> None:
    latch = Latch()
    latch.add([stop("key1")], 2, 110)
    latch.add([stop("gate died")], 3, 200)
    assert told(latch.reset(3, 199)) == (
        False,
        "asked before the last stop (gate died): deal with that stop, then ask again",
    )
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

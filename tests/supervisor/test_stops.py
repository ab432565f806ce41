"""A stop: who wrote it, and the cause that it is told with."""

from __future__ import annotations

import itertools

import pytest

from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.supervisor.stops import SOONER_NS, Stop, explained
from tests.support.why import why

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

"""Asserted: facts of the core that cannot be otherwise, looked at whenever it runs. One that is otherwise latches a
stop whose cause names it: `internal error: ...`, or the fault of a refused frame.
"""

from __future__ import annotations

from typing import NamedTuple


class Assertion(NamedTuple):
    """One of them."""

    says: str
    where: str
    """The process that looks, and when."""
    claims: tuple[str, ...]
    test: str
    """The test that makes it fail and sees the robot stop."""


BEFORE_MOTION = "port owner, before it writes a motion frame"
MADE_TO_FAIL = "tests/lab/case/test_invariants.py"
ASSERTIONS = (
    Assertion("the epoch only grows", "port owner, when it changes", ("MOVE-1", "MOVE-2"), MADE_TO_FAIL),
    Assertion("one process writes the port owner's memory", BEFORE_MOTION, ("MOVE-1",), MADE_TO_FAIL),
    Assertion("no stop is latched", BEFORE_MOTION, ("MOVE-2",), MADE_TO_FAIL),
    Assertion("the frame is newer than the last stop", BEFORE_MOTION, ("MOVE-1", "MOVE-2"), MADE_TO_FAIL),
    Assertion(
        "the frame is a whole one and within the limits", BEFORE_MOTION, ("LIMIT-1",), "tests/procs/test_port_owner.py"
    ),
    Assertion(
        "a process is in a state in which what happens to it can happen", "supervisor, at each event",
        ("MOVE-2",), "tests/supervisor/test_watching.py",
    ),
)  # fmt: skip

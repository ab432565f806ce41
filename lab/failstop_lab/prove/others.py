"""Others: notices when somebody else than the test stops the robot, or the robot itself for a reason that the test does
not bring about. Somebody may have a hand at a wheel then, so the test must neither reset that stop nor go on."""

from __future__ import annotations

import time

from failstop.api.errors import FailstopError
from failstop.api.events import EventLog
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop_lab.faults.fault import Wanted
from failstop_lab.trial import TrialError

LOOK_EVERY_S = 0.05
SAFE = "prove: safe"
STRIKE = "prove"
OWN = frozenset(str(causes.PIPED(reason)) for reason in (STRIKE, SAFE))
"""The test's own stop requests, as events have them."""
STOPS = frozenset(("stop", "stop_again", "stop_also"))
"""The kinds of events about a stop. While a stop is latched, another one leaves nothing but its event."""
ENDING = frozenset(
    kind.name
    for kind in (
        *causes.BY_SOMEBODY,
        *(causes.RUNAWAY, causes.UNCOUNTED, causes.BATTERY),
    )
)
"""Stops for these causes end a test, unless its present row brings them about."""


class StoppedByOthers(TrialError):
    """The test must not go on."""


class Others:
    """Reads the events of the test's service."""

    def __init__(self) -> None:
        self._wanted = frozenset((causes.RUNAWAY.name, causes.UNCOUNTED.name))
        """The causes that the present row brings about, by name. Before the first row the test measures the
        robot, and judges by its reports what its wheels do."""
        self._before: frozenset[str] = frozenset()
        """Those of the row before, whose stop may still be latched."""
        self.why = ""
        """The first stop that the test has not brought about; empty: there was none."""
        self._log: EventLog | None = None
        self._looked_s = 0.0

    def attach(self, name: str) -> None:
        """Read the events of the run of this service, from its first one. Raises FailstopError."""
        self._log = EventLog(name)

    def begin(self, wanted: tuple[Wanted, ...]) -> None:
        """A row begins, which brings about one of these causes."""
        self.look()
        self._before, self._wanted = self._wanted, frozenset(kind.name for kind, *_ in wanted) - {causes.PIPED.name}

    def let_go(self) -> None:
        """Read what is left, and let go of the run."""
        self.look()
        self._log = None

    def look_now_and_then(self) -> None:
        """look(), at most every LOOK_EVERY_S."""
        if time.monotonic() - self._looked_s >= LOOK_EVERY_S:
            self.look()

    def look(self) -> None:
        """Read the events since the last look."""
        self._looked_s = time.monotonic()
        if self._log is None:
            return
        try:
            found = self._log.read()
        except FailstopError:
            self._log = None  # the run has ended, and all its events were read
            return
        for event in found:
            reason, cause = str(event.fields.get("reason")), str(event.fields.get("cause"))
            if event.kind in STOPS and self._ends(cause, reason):
                self.why = self.why or reason

    def _ends(self, cause: str, reason: str) -> bool:
        return cause in ENDING - self._wanted and reason not in OWN

    def check(self, cause: Cause | None = None) -> None:
        """Raise StoppedByOthers if the test must not drive any more. `cause`: what is latched. Its event may come a
        moment later."""
        self.look()
        if cause and cause.kind.name not in self._before and self._ends(cause.kind.name, str(cause)):
            self.why = self.why or str(cause)
        if self.why:
            raise StoppedByOthers(
                f"stopped, but not by the test: {self.why}; once the reason is gone, start the test again"
            )

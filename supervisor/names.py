"""Names: whether what this run shares with others can still be found by its name.

Whoever has a segment attached goes on working when its name is taken away, as logind's RemoveIPC=yes does when the
service's user logs out. But no process can be started again from then on, no client can come, and without the name of
the stop pipe nobody can ask for a stop. Nothing here can mend that: the next run makes its own.
"""

from __future__ import annotations

import os

from failstop.policy import causes
from failstop.supervisor.resources import SHARED_MEMORY

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause
    from failstop.supervisor.events import Events

LOOK_EVERY_NS = 1_000_000_000
A_SLOT = f"{SHARED_MEMORY}client."
"""What the service can go on without."""


class Names:
    """Told of here: what was taken away. One lost() a turn."""

    __slots__ = ("_events", "_looked_ns", "_named")

    def __init__(self, named: dict[str, int], events: Events) -> None:
        """`named`: a descriptor of each, by what people call it."""
        self._named = dict(named)
        self._events = events
        self._looked_ns = 0

    def lost(self, now_ns: int) -> Cause | None:
        """Why the service can't go on; None while it can. Looks once a second."""
        if now_ns - self._looked_ns < LOOK_EVERY_NS:
            return None
        self._looked_ns = now_ns
        gone = [name for name, fd in self._named.items() if not os.fstat(fd).st_nlink]
        for name in gone:
            del self._named[name]
        if vital := [name for name in gone if not name.startswith(A_SLOT)]:
            text = f"{', '.join(vital)}: removed; ending, for a new run to make it again"
            doubt = "next: is RemoveIPC=yes in logind.conf? `failstop doctor` looks"
            self._events.tell("note", f"{text}; {doubt}", level="error")
            return causes.REMOVED(vital[0])
        for name in gone:
            text = f"{name} was removed: that client slot is out of use; next: restart the service when it may stop"
            self._events.tell("note", text, level="warning")
        return None

"""Attending: the operators whose devices are proven to be there, for the gate, which alone counts the time. The gate
hears of one at a time, the one that was proven last."""

from __future__ import annotations

import contextlib

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.web.lease import Lease

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.web.viewer import Viewer


class Attending:
    """The operators who attend by the page."""

    def __init__(self, name: str, ended: Callable[[Viewer], None]) -> None:
        """`ended`: is told of a viewer that attends no more."""
        self._name = name
        self._ended = ended
        self._robot: Robot | None = None
        self._leases: dict[Viewer, tuple[str, Lease]] = {}

    def of(self, viewer: Viewer) -> Lease | None:
        """The lease of a viewer that attends."""
        found = self._leases.get(viewer)
        return found[1] if found else None

    def begin(self, viewer: Viewer, who: str, key: bytes) -> None:
        """A device attends, from its first answer on."""
        self._leases[viewer] = who, Lease(key)

    def proven(self, viewer: Viewer) -> str:
        """The answer of this viewer has proven something new; returns what is wrong with telling the gate."""
        return self._renew() if self._leases[viewer] is self._last() else ""

    def end(self, viewer: Viewer) -> None:
        """A device attends no more: the gate is told at once who is left, and when that one was proven, which may be
        too long ago."""
        last = self._last()
        found = self._leases.pop(viewer, None)
        self._ended(viewer)
        if found is not None and found is last:
            self._renew()

    def _last(self) -> tuple[str, Lease] | None:
        """The one that was proven last, if any was."""
        found = max(self._leases.values(), key=lambda each: each[1].proven_ns, default=None)
        return found if found and found[1].proven_ns else None

    def _renew(self) -> str:
        last = self._last()
        if last is None:
            self._close()
            return ""
        who, lease = last
        try:
            if self._robot is None:
                self._robot = Robot(self._name, client="failstop web")
            self._robot.attend(who, lease.proven_ns)
        except FailstopError as error:
            self._close()
            return str(error)
        return ""

    def _close(self) -> None:
        robot, self._robot = self._robot, None
        if robot:
            with contextlib.suppress(FailstopError):
                robot.leave()
            robot.close()

    def close(self) -> None:
        """The page ends, and with it all attending by it."""
        for viewer in tuple(self._leases):
            self.end(viewer)

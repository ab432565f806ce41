"""Attending: reports to the gate the operators whose devices have proven that they are present. Only the gate counts
the time. It hears about one operator at a time, the one whose device has proven it last."""

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
    """The operators who attend through the page."""

    def __init__(self, name: str, ended: Callable[[Viewer], None]) -> None:
        """`ended`: called with each viewer that no longer attends."""
        self._name = name
        self._ended = ended
        self._robot: Robot | None = None
        self._leases: dict[Viewer, tuple[str, Lease]] = {}

    def of(self, viewer: Viewer) -> Lease | None:
        """The lease of a viewer; None if it does not attend."""
        found = self._leases.get(viewer)
        return found[1] if found else None

    def begin(self, viewer: Viewer, who: str, key: bytes) -> None:
        """A device begins to attend; it counts from its first answer on."""
        self._leases[viewer] = who, Lease(key)

    def proven(self, viewer: Viewer) -> str:
        """An answer of this viewer has proven something new, so report it to the gate. Returns what went wrong, or
        ""."""
        return self._renew() if self._leases[viewer] is self._last() else ""

    def end(self, viewer: Viewer) -> None:
        """A device no longer attends. The gate is told at once which operator is left, and when that one's device has
        last proven it, which may be too long ago."""
        last = self._last()
        found = self._leases.pop(viewer, None)
        self._ended(viewer)
        if found is not None and found is last:
            self._renew()

    def _last(self) -> tuple[str, Lease] | None:
        """The operator whose device has proven it last, with its lease; None if there is none."""
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
        """The page ends, so nobody attends through it any more."""
        for viewer in tuple(self._leases):
            self.end(viewer)

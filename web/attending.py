"""Attending: the operators whose devices are proven to be there, for the gate, which alone counts the time."""

from __future__ import annotations

import contextlib

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.web.lease import Lease

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.handlers import Live


class Attending:
    """Who attends by the page. The gate hears of one at a time, the one that was proven last."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._robot: Robot | None = None
        self._leases: dict[Live, tuple[str, Lease]] = {}

    def of(self, viewer: Live) -> Lease | None:
        """The lease of a viewer that attends."""
        found = self._leases.get(viewer)
        return found[1] if found else None

    def names(self) -> list[str]:
        """Who attends."""
        return sorted({who for who, _ in self._leases.values()})

    def begin(self, viewer: Live, who: str, key: bytes) -> None:
        """A device attends, from its first answer on."""
        self._leases[viewer] = who, Lease(key)

    def proven(self, viewer: Live) -> str:
        """An answer has proven something new; returns what is wrong with telling the gate."""
        who, lease = self._leases[viewer]
        try:
            if self._robot is None:
                self._robot = Robot(self._name, client="failstop web")
            self._robot.attend(who, lease.proven_ns)
        except FailstopError as error:
            self._close()
            return str(error)
        return ""

    def end(self, viewer: Live) -> None:
        """A device attends no more: told at once, unless another one does."""
        found = self._leases.pop(viewer, None)
        if found is None:
            return
        if not any(lease.proven_ns for _, lease in self._leases.values()):
            self._close()

    def _close(self) -> None:
        robot, self._robot = self._robot, None
        if robot:
            with contextlib.suppress(FailstopError):
                robot.leave()
            robot.close()

    def close(self) -> None:
        """The page ends: whoever attends by it does no more."""
        for viewer in tuple(self._leases):
            self.end(viewer)

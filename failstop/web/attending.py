"""Attending: reports to the gate that an operator is present, once the operator's device has proved this. Only the
newest proof of all operators is reported. The gate alone decides when a proof is too old."""

from __future__ import annotations

import contextlib

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.web.lease import Lease

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from failstop.web.viewer import Viewer


class Attending:
    """Keeps track of the operators who attend the robot through the page."""

    def __init__(self, name: str, ended: Callable[[Viewer, Collection[Viewer]], None]) -> None:
        """`ended` is called with each viewer that stops attending or leaves, and with the viewers that still attend."""
        self._name = name
        self._ended = ended
        self._robot: Robot | None = None
        self._leases: dict[Viewer, tuple[str, Lease]] = {}

    def of(self, viewer: Viewer) -> Lease | None:
        """Return the lease that checks the proofs of this viewer. None if the viewer does not attend."""
        found = self._leases.get(viewer)
        return found[1] if found else None

    def begin(self, viewer: Viewer, who: str, key: bytes) -> None:
        """Let a viewer begin to attend. The operator counts as present from the device's first correct answer. `who`:
        the operator. `key`: the key with which the device computes its answers."""
        self._leases[viewer] = who, Lease(key)

    def proven(self, viewer: Viewer) -> str:
        """Report a viewer's new proof to the gate, unless another viewer's proof is newer. Returns an error text, or
        ""."""
        return self._renew() if self._leases[viewer] is self._last() else ""

    def end(self, viewer: Viewer) -> None:
        """End a viewer's attendance. If this viewer's proof was the newest, report the next newest proof to the gate at
        once."""
        last = self._last()
        found = self._leases.pop(viewer, None)
        self._ended(viewer, self._leases.keys())
        if found is not None and found is last:
            self._renew()

    def _last(self) -> tuple[str, Lease] | None:
        """Return the operator with the newest proof, and that operator's lease. None without any proof."""
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
        """End the attendance of all viewers, because the page closes."""
        for viewer in tuple(self._leases):
            self.end(viewer)

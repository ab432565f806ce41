"""Attendance: an operator who is there, for a robot that drives only while somebody is (setting attend.required)."""

from __future__ import annotations

import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import TracebackType

    from failstop.api.session import Session


class Attendance:
    """Of one operator; a context manager, whose end gives it up.

    with robot.attend("Anna") as attendance:
        while anna_is_there():
            attendance.renew()
            time.sleep(0.1)

    Who stops renewing it is gone after attend.lease_s (1 s), and that latches a stop; so does give_up(), at once,
    unless somebody else attends. The robot's clock alone counts.
    """

    def __init__(self, session: Session, who: str) -> None:
        self._session = session
        self.who = who
        """As people see it."""

    def __enter__(self) -> Attendance:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.give_up()

    def renew(self, proven_ns: int | None = None) -> None:
        """The operator was there at `proven_ns` (CLOCK_MONOTONIC, ns; default: now), such as when a question was put
        that has been answered since. Repeat it every 0.1 s or so. Raises NoService when no service runs."""
        self._session._attended(self.who, time.monotonic_ns() if proven_ns is None else proven_ns)

    def give_up(self, who: str = "") -> None:
        """The operator leaves. Raises NoService."""
        self._session._attended(who or self.who, 0)

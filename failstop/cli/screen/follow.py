"""Follow: the state of a service that may end and come back as another run."""

from __future__ import annotations

from failstop.api.client import attach
from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event, EventLog
from failstop.api.state import StateReader
from failstop.shm import layout

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State

KEPT = 256
CHECK_S = 0.5
"""Time between two looks whether it is still the same run."""


class Follower:
    """Reads the state of whatever run of the service is there."""

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError: there must be one at first."""
        self.name = name
        self.reader: StateReader | None = StateReader(name)
        self.note = ""
        """Why there is no state now."""
        self.events: list[Event] = []
        """What this run has told, oldest first, the last of it."""
        self._log = EventLog(name)
        self._check_s = 0.0

    def read(self, now_s: float) -> State | None:
        """The state; None while there is none, and then `note` says why. `now_s`: a monotonic clock."""
        if now_s >= self._check_s:
            self._check_s = now_s + CHECK_S
            self._check()
        if self.reader is None:
            return None
        try:
            return self.reader.read()
        except FailstopError as error:
            self.note = str(error)
            return None

    def _check(self) -> None:
        try:
            run = attach(self.name, layout.SUPERVISOR).incarnation
            if self.reader is None or self.reader.incarnation != run:
                self.reader = StateReader(self.name)
                self._log, self.events = EventLog(self.name), []
            self.events = [*self.events, *self._log.read()][-KEPT:]
        except NoService:
            self._lose(f"no service named {self.name!r} is running")
        except FailstopError as error:
            self._lose(str(error))

    def _lose(self, why: str) -> None:
        self.reader = None
        self.note = why

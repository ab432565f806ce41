"""Watcher: reads the robot's state once for all viewers, so another viewer costs little."""

from __future__ import annotations

import json
from typing import Any

from failstop.api import dates
from failstop.api.errors import FailstopError, NoService
from failstop.api.follow import Follower, Vibration
from failstop.web import view

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State

PERIOD_S = 0.1
SLOW_S = 0.5
"""The time between two updates of the values that people read, s. If something important changes, they are updated at
once."""
AGAIN_S = 0.5
"""The time between two attempts to find a service while none is running, s."""


class Watcher:
    """Reads the robot's state, and makes the values that the page shows."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: State | None = None
        self.shown: dict[str, Any] = view.absent("")
        """The values that change rarely."""
        self.values: list[Any] | None = None
        """The values that change all the time. None while no service is running."""
        self.number = 0
        """How often `shown` has changed."""
        self._follower: Follower | None = None
        self._note = f"no service named {name!r} is running"
        self._gone = True
        """True if no service is running. False if the service may be running, but can't be read."""
        self._vibration = Vibration()
        self._key: object = None
        self._drawn_s = self._tried_s = float("-inf")
        self._text = ""

    def look(self, now_s: float, unix_s: float) -> None:
        """Read the state. Call it every PERIOD_S while there are viewers, and before answering a request that needs the
        current state. `now_s`: time.monotonic(). `unix_s`: Unix time."""
        self.state = self._read(now_s)
        if self.state is None:
            self.values = None
            self._show(view.absent(self._note, gone=self._gone))
            self._key = None
            return
        self.values = view.live(self.state, self._vibration.update(self.state.imu, now_s))
        key = self._what_matters(self.state)
        if key != self._key or now_s - self._drawn_s >= SLOW_S:
            self._key, self._drawn_s = key, now_s
            assert self._follower is not None
            self._show(view.view(*dates.dated(self.state, self._follower.events, dates.now()), unix_s))

    @staticmethod
    def _what_matters(state: State) -> object:
        moves, board = any(state.wheels_radps), (state.device, state.last_stop)
        turning = state.turning.does, state.turning.unexpected
        return state.blocked, state.enabled, state.epoch, state.waiting_for, *board, moves, *turning, state.speed_limit

    def _show(self, shown: dict[str, Any]) -> None:
        text = json.dumps(shown, sort_keys=True)
        if text != self._text:
            self._text = text
            self.shown = shown
            self.number += 1

    def _read(self, now_s: float) -> State | None:
        if self._follower is None:
            if now_s - self._tried_s < AGAIN_S:
                return None
            self._tried_s = now_s
            try:
                self._follower = Follower(self.name)
            except FailstopError as error:
                self._note, self._gone = str(error), isinstance(error, NoService)
                return None
        state = self._follower.read(now_s)
        if state is None:
            self._note, self._gone = self._follower.note, self._follower.absent
        return state

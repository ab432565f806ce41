"""Link: the bridge's connection to the service, made anew when the service was. One for each thread."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns
from typing import TypeVar

from failstop.api.client import send_stop
from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused
from failstop.api.robot import Robot
from failstop.api.state import State
from failstop.ros2 import words
from failstop.ros2.commanders import Reason
from failstop.ros2.contract import CLIENT

ANSWER_S = 0.5
AGAIN_NS = 200_000_000
STALE_S = 0.5
"""A state as old as this may be of a run that is over."""
T = TypeVar("T")


class RobotLink:
    """A Robot when there is a service."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._robot: Robot | None = None
        self._problem = FailstopError("not connected yet")
        self._tried_ns = -AGAIN_NS

    def stop(self, reason: str) -> None:
        """Ask for a latched stop, by the stop pipe: connected or not, whatever the last call came to. Raises NoService
        when nothing is there to stop."""
        given, row = (reason.given, reason.row.name) if isinstance(reason, Reason) else (reason, "")
        words.asked(given, row)
        send_stop(self.name, given, CLIENT, row)

    def call(self, act: Callable[[Robot], T], *, at_once: bool = False) -> T:
        """Do something with the robot. Raises FailstopError; a service that has gone is looked for at the next call,
        five times a second at most but for what is to be done `at_once`."""
        try:
            return act(self._connected(at_once=at_once))
        except (Refused, NoAnswer):
            raise
        except FailstopError as error:
            self._problem = error
            self.close()
            raise

    def _connected(self, *, at_once: bool) -> Robot:
        if self._robot is None:
            if not at_once and monotonic_ns() - self._tried_ns < AGAIN_NS:
                raise self._problem
            self._tried_ns = monotonic_ns()
            self._robot = Robot(self.name, client=CLIENT, answer_s=ANSWER_S, disable_on_exit=False)
        return self._robot

    def state(self) -> State:
        """A state of the run that is there now. Raises FailstopError."""
        found = self.call(lambda robot: robot.state)
        if found.age_s > STALE_S and monotonic_ns() - self._tried_ns >= AGAIN_NS:
            self.close()
            found = self.call(lambda robot: robot.state)
        return found

    def close(self, failed: BaseException | None = None) -> None:
        """Give the connection back: what the bridge commanded ends at once. `failed`: by what the bridge ends, which is
        then the death of a driver."""
        if self._robot:
            self._robot.__exit__(type(failed), failed, None)
            self._robot = None


__all__ = ["FailstopError", "NoAnswer", "NoService", "Refused", "RobotLink"]

"""Link: the bridge's connection to the service, which survives a restart of the service. Each thread needs its own
link."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns
from typing import TypeVar

from failstop.api.client import send_stop
from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused
from failstop.api.robot import Robot
from failstop.api.snapshot import Sample
from failstop.api.state import State
from failstop.ros2 import words
from failstop.ros2.commanders import Reason
from failstop.ros2.contract import CLIENT

ANSWER_S = 0.5
AGAIN_NS = 200_000_000
STALE_S = 0.5
"""If a state is older than this, s, its run may have ended."""
T = TypeVar("T")


class RobotLink:
    """A connection to the service, as a Robot of the API. The first call connects, and a later call connects again
    after a loss."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._robot: Robot | None = None
        self._problem = FailstopError("not connected yet")
        self._tried_ns = -AGAIN_NS

    def stop(self, reason: str) -> None:
        """Request a latched stop through the stop pipe. This works without a connection, and after a failed call.
        Raises NoService if there is no service to stop."""
        given, row = (reason.given, reason.row.name) if isinstance(reason, Reason) else (reason, "")
        words.asked(given, row)
        send_stop(self.name, given, CLIENT, row)

    def call(self, act: Callable[[Robot], T], *, at_once: bool = False) -> T:
        """Call `act` with the robot. Raises FailstopError. After the connection was lost, calls try to connect again at
        most five times a second. A call that is `at_once` always tries."""
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
        """The state of the present run. Raises FailstopError."""
        found = self.call(lambda robot: robot.state)
        if found.age_s > STALE_S and monotonic_ns() - self._tried_ns >= AGAIN_NS:
            self.close()
            found = self.call(lambda robot: robot.state)
        return found

    def samples(self) -> tuple[str, list[Sample]]:
        """(the name of the present run, its samples since the last call), as Robot.samples(). Raises FailstopError."""

        def read(robot: Robot) -> tuple[str, list[Sample]]:
            with robot._lock:
                run = robot._current()
                return run.found[0], run.samples()

        return self.call(read)

    def close(self, failed: BaseException | None = None) -> None:
        """Close the connection, which ends everything that was commanded through it. `failed`: the error that ends the
        bridge. The bridge then counts as a driver that has died."""
        if self._robot:
            self._robot.__exit__(type(failed), failed, None)
            self._robot = None


__all__ = ["FailstopError", "NoAnswer", "NoService", "Refused", "RobotLink"]

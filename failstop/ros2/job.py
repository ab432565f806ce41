"""Job: a request to the service that takes seconds, in its own thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.ros2.link import RobotLink


class Job:
    """A request that runs in its own thread. Call the job to find out whether it has ended."""

    def __init__(self, link: RobotLink, act: Callable[[Robot], Any], *, at_once: bool = False) -> None:
        """Starts the thread. `at_once`: as for RobotLink.call()."""
        self._found: Any = None
        self._error: FailstopError | None = None
        self._thread = threading.Thread(target=self._run, args=(link, act, at_once), daemon=True)
        self._thread.start()

    def _run(self, link: RobotLink, act: Callable[[Robot], Any], at_once: bool) -> None:
        try:
            self._found = link.call(act, at_once=at_once)
        except FailstopError as error:
            self._error = error
        except ValueError as error:
            self._error = FailstopError(str(error))

    def __call__(self) -> bool:
        return not self._thread.is_alive()

    def result(self) -> Any:
        """The result of a job that has ended. Raises FailstopError if it failed."""
        if self._error:
            raise self._error
        return self._found

"""Workers: carries out the requests of paired devices in threads. A running request occupies one of the service's
client slots."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot

TOUCHED = ("disable", "limit")
"""Requests that need only a touch of a button: `disable`, and also `limit` if it does not raise the speed limit. For
everything else, the person must hold the button."""
MOST_AT_WORK = 4


class Workers:
    """Carries out each request in its own thread, so a slow one does not delay a STOP. While MOST_AT_WORK requests run,
    further requests are refused. Requests must not queue, because a delayed reset could clear a newer stop."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._threads = ThreadPoolExecutor(MOST_AT_WORK, "workers")
        self._waiting = 0

    async def ask(self, verb: str, who: str, percent: int | None = None, epoch: int | None = None) -> tuple[bool, str]:
        """Carry out a request. Returns (True if it was granted, the answer in words). `percent`: the limit, for
        `limit`. `epoch`: the epoch of the newest stop that the person has seen, for `reset`."""
        if self._waiting >= MOST_AT_WORK:
            return False, "the page is busy: try again in a moment"
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, self._ask, verb, who, percent, epoch)
        finally:
            self._waiting -= 1

    def _ask(self, verb: str, who: str, percent: int | None, epoch: int | None) -> tuple[bool, str]:
        try:
            with Robot(self._name, client=who, disable_on_exit=False) as robot:
                if verb == "limit":
                    return True, robot.limit_speed((percent or 0) / 100)
                if verb == "reset":
                    return True, robot.reset(seen=epoch)
                return True, {"enable": robot.enable, "disable": robot.disable}[verb]()
        except Refused as refused:
            return False, refused.reason
        except (FailstopError, ValueError) as error:
            return False, str(error)

    def close(self) -> None:
        """End without waiting for requests that are still running."""
        self._threads.shutdown(wait=False, cancel_futures=True)

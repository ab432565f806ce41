"""Workers: carry out the requests of paired devices. Each request takes a client slot for as long as it lasts."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot

TOUCHED = ("disable", "limit")
"""Requests for which a touch is enough. For the others, and for a higher limit, a button must be held."""
MOST_AT_WORK = 4


class Workers:
    """Each request has a thread. So one that takes long, such as an enable with an arm, delays no STOP and no disable.
    It also delays no reset, which could then clear a stop that its operator did not know of."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._threads = ThreadPoolExecutor(MOST_AT_WORK, "workers")
        self._waiting = 0

    async def ask(self, verb: str, who: str, percent: int | None = None, epoch: int | None = None) -> tuple[bool, str]:
        """Returns (done, answer). `percent`: the speed limit; `epoch`: the newest stop that the person knew of."""
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
        """End without waiting for running requests."""
        self._threads.shutdown(wait=False, cancel_futures=True)

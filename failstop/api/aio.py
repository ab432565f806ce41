"""AsyncRobot: a Robot for asyncio. What takes time is awaited, what takes none is called."""

from __future__ import annotations

import asyncio
from contextlib import closing

from failstop.api.calls import Calls
from failstop.api.events import LOOK_EVERY_S, Event, EventLog
from failstop.api.news import News
from failstop.api.waiting import Steps, T, limiting
from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from types import TracebackType

    from failstop.api.session import Prepare, Told
    from failstop.api.snapshot import State
    from failstop.api.waiting import Word


class AsyncRobot(Calls):
    """What `Robot.connect()` returns; an asynchronous context manager. It belongs to one event loop. What is
    not here is as Robot has it."""

    async def __aenter__(self) -> AsyncRobot:
        self._check_open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._close(in_order=not isinstance(error, Exception))

    async def _answered(self, verb: int, told: Told = None, prepare: Prepare = None) -> str:
        return await _through(self._asking(verb, told, prepare, task=asyncio.current_task()))

    async def enable(self, told: Callable[[str], None] | None = None) -> str:
        """As Robot.enable."""
        return await self._answered(records.ENABLE, told)

    async def disable(self) -> str:
        """As Robot.disable."""
        return await self._answered(records.DISABLE)

    async def reset(self) -> str:
        """As Robot.reset."""
        return await self._answered(records.RESET)

    async def limit_speed(self, share: float) -> str:
        """As Robot.limit_speed."""
        return await self._answered(records.LIMIT, prepare=limiting(share))

    async def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """As Robot.wait_for."""
        return await _through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> AsyncIterator[Event]:
        """As Robot.events: `async for event in robot.events()`. What is told from this call on, whenever it is read: a
        task that calls it itself may start late."""
        log = EventLog(self.name)
        if not past:
            log.skip()
        return _follow(log)


async def _through(steps: Steps[T]) -> T:
    """Take the steps, as waiting.sleep_through() does; the event loop goes on in between."""
    try:
        while True:
            news, for_s = next(steps)
            await (_news(news, for_s) if news else asyncio.sleep(for_s))
    except StopIteration as done:
        found: T = done.value
        return found
    finally:
        steps.close()


async def _follow(log: EventLog) -> AsyncIterator[Event]:
    with closing(News(log.name)) as news:
        while True:
            news.look()
            found = log.read()
            for event in found:
                yield event
            if not found:
                await _news(news, LOOK_EVERY_S)


async def _news(news: News, timeout_s: float) -> None:
    """Wait until there may be news, as news.wait() does; the event loop goes on."""
    loop = asyncio.get_running_loop()
    told = asyncio.Event()
    if news.fd >= 0:
        loop.add_reader(news.fd, told.set)
    try:
        await asyncio.wait_for(told.wait(), timeout_s)
    except asyncio.TimeoutError:
        pass
    finally:
        if news.fd >= 0:
            loop.remove_reader(news.fd)

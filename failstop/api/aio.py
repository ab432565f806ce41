"""AsyncRobot: a Robot for asyncio. It wraps the same one; what takes time is awaited, what takes none is called."""

from __future__ import annotations

import asyncio
from contextlib import closing

from failstop.api.events import LOOK_EVERY_S, Event, EventLog
from failstop.api.news import News
from failstop.api.robot import Robot
from failstop.api.waiting import Steps, T, ask, limiting, reach
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE
from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from types import TracebackType

    from failstop.api.client import Client
    from failstop.api.driving import Answer
    from failstop.api.samples import Sample
    from failstop.api.snapshot import State
    from failstop.api.waiting import Word
    from failstop.api.why import Why


class AsyncRobot:
    """What `Robot.connect()` returns; an asynchronous context manager. It belongs to one event loop."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        """The Robot itself, for what is not here; what it waits for holds the event loop up."""
        self._turn = asyncio.Lock()

    async def __aenter__(self) -> AsyncRobot:
        self.robot.__enter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self.robot.__exit__(kind, error, at)

    async def _ask(
        self, verb: int, told: Callable[[str], None] | None = None, prepare: Callable[[Client], None] | None = None
    ) -> str:
        async with self._turn:
            return await _through(ask(self.robot, verb, self.robot._answer_s, told, prepare))

    async def enable(self, told: Callable[[str], None] | None = None) -> str:
        """As Robot.enable."""
        return await self._ask(records.ENABLE, told)

    async def disable(self) -> str:
        """As Robot.disable."""
        return await self._ask(records.DISABLE)

    async def reset(self) -> str:
        """As Robot.reset."""
        return await self._ask(records.RESET)

    async def limit_speed(self, share: float) -> str:
        """As Robot.limit_speed."""
        return await self._ask(records.LIMIT, prepare=limiting(share))

    async def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """As Robot.wait_for."""
        return await _through(reach(self.robot, what, timeout_s))

    def events(self, *, past: bool = False) -> AsyncIterator[Event]:
        """As Robot.events: `async for event in robot.events()`. What is told from this call on, whenever it is read: a
        task that calls it itself may start late."""
        log = EventLog(self.robot.name)
        if not past:
            log.skip()
        return _follow(log)

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = DEFAULT_SOURCE) -> Answer:
        """As Robot.drive; it is not awaited, since it takes no time."""
        return self.robot.drive(vx, vy, wz, manual=manual, source=source)

    def sensed(self) -> None:
        """As Robot.sensed."""
        self.robot.sensed()

    def hold(self, *interlocks: str) -> None:
        """As Robot.hold."""
        self.robot.hold(*interlocks)

    def say(self, sees: str, wrong: str = "") -> None:
        """As Robot.say."""
        self.robot.say(sees, wrong)

    def estop(self, reason: str = "") -> None:
        """As Robot.estop."""
        self.robot.estop(reason)

    def why(self) -> Why:
        """As Robot.why."""
        return self.robot.why()

    def samples(self) -> list[Sample]:
        """As Robot.samples."""
        return self.robot.samples()

    @property
    def state(self) -> State:
        """As Robot.state."""
        return self.robot.state

    @property
    def settings(self) -> dict[str, float | str]:
        """As Robot.settings."""
        return self.robot.settings


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

"""Robot and AsyncRobot: drive and stop a robot from Python. What takes time waits in the one, and is awaited in the
other.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator

from failstop.api.calls import Calls
from failstop.api.events import LOOK_S, Event, EventLog
from failstop.api.session import Steps, T, Told, Word, sleep_through
from failstop.api.snapshot import State
from failstop.shm import records


class AsyncRobot(Calls):
    """What `Robot.connect()` returns; an asynchronous context manager. It belongs to one event loop. What is
    not here is as Robot has it."""

    async def __aenter__(self) -> AsyncRobot:
        self._check_open()
        return self

    async def __aexit__(self, *raised: object) -> None:
        self._close(in_order=not isinstance(raised[1], Exception))

    async def _answered(self, verb: int, told: Told = None) -> str:
        return await _through(self._asking(verb, told, awaited=True))

    async def enable(self, told: Told = None) -> str:
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
        return await _through(self._limiting(share, awaited=True))

    async def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """As Robot.wait_for."""
        return await _through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> AsyncIterator[Event]:
        """As Robot.events: `async for event in robot.events()`. What is told from this call on, whenever it is read: a
        task that calls it itself may start late."""
        return _follow(EventLog(self.name, past=past))


class Robot(Calls):
    """A connection to the running service of that name; a context manager.

    Reading the state and estop() need no permission. The other calls take one of the service's client slots, at their
    first use, which needs the group `failstop` (or the service's user).

    A service that was restarted is noticed by every call, which then means the new run; nothing is enabled by it.
    While none runs every call raises NoService. With `reconnect=False` a Robot is of one run: once that has ended,
    every call raises NoService. After close() every call but estop() raises FailstopError, whichever thread makes it.
    A Robot that nobody refers to any more gives its slot back; one that was inherited by a fork takes one of its own.

    Several threads may use one Robot: it is one client, so the newest drive() of any of them counts. One that has a
    slot keeps a thread of its own, which only sleeps: by its end the gate knows of this program's death at once,
    however long the kernel takes its memory down.
    """

    connect = AsyncRobot
    """The same for asyncio: `async with Robot.connect() as robot`. What takes time is awaited there."""

    def __enter__(self) -> Robot:
        self._check_open()
        return self

    def __exit__(self, *raised: object) -> None:
        self._close(in_order=not isinstance(raised[1], Exception))

    def enable(self, told: Told = None) -> str:
        """Enable motion. Raises Refused with the reason: latched, not ready, an interlock that does not hold, or asked
        before the last stop. With an arm it goes to its drive pose first, which takes seconds; `told` is called with
        how far it is. It can be given up by arm.hold(), disable(), or a stop."""
        return sleep_through(self._asking(records.ENABLE, told))

    def disable(self) -> str:
        """Disable motion: the wheels stop at once."""
        return sleep_through(self._asking(records.DISABLE))

    def reset(self) -> str:
        """Clear the latched stop; motion stays disabled until enable(). With nothing latched it changes nothing. Raises
        Refused."""
        return sleep_through(self._asking(records.RESET))

    def limit_speed(self, share: float) -> str:
        """Allow every driver this share of the settings' speeds, 0.05 to 1, until another is set or the service ends.
        It counts at once, by the ramps. Raises Refused, ValueError."""
        return sleep_through(self._limiting(share))

    def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """Wait until the state is so, and return it: a word (docs/python.md), or what a function of the state
        says. A service that is not there is waited for too, unless this Robot is of one run. Raises TimedOut, which
        says what is the case and what to do, and ValueError for a word that there is not."""
        return sleep_through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> Iterator[Event]:
        """What the service tells people, as it happens: stops, deaths, requests (docs/journal.md). Waits for the next
        one without end. `past`: first what the run has told so far, the last 256. Raises NoService when this run of the
        service has ended."""
        return EventLog(self.name, past=past).follow()


async def _through(steps: Steps[T]) -> T:
    """Take the steps, as session.sleep_through() does; the event loop goes on in between."""
    import asyncio  # takes as long as all else here

    try:
        while True:
            await asyncio.sleep(next(steps))
    except StopIteration as done:
        found: T = done.value
        return found
    finally:
        steps.close()


async def _follow(log: EventLog) -> AsyncIterator[Event]:
    import asyncio

    while True:
        found = log.read()
        for event in found:
            yield event
        if not found:
            await asyncio.sleep(LOOK_S)

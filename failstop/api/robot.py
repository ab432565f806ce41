"""Robot: drive and stop a robot from Python."""

from __future__ import annotations

from types import TracebackType

from failstop.api.calls import Calls
from failstop.api.errors import FailstopError, Refused
from failstop.api.events import LOOK_EVERY_S, Event, EventLog
from failstop.api.session import ANSWER_S
from failstop.api.snapshot import State
from failstop.api.waiting import limiting, sleep_through
from failstop.shm import records
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from failstop.api.aio import AsyncRobot
    from failstop.api.waiting import Word


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

    def __enter__(self) -> Robot:
        self._check_open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._close(in_order=not isinstance(error, Exception))

    @classmethod
    def connect(
        cls,
        name: str = DEFAULT_NAME,
        *,
        client: str | None = None,
        reconnect: bool = True,
        answer_s: float = ANSWER_S,
        disable_on_exit: bool = True,
    ) -> AsyncRobot:
        """The same for asyncio: `async with Robot.connect() as robot`. What takes time there is awaited."""
        from failstop.api.aio import AsyncRobot

        return AsyncRobot(name, client=client, reconnect=reconnect, answer_s=answer_s, disable_on_exit=disable_on_exit)

    def enable(self, told: Callable[[str], None] | None = None) -> str:
        """Enable motion. Raises Refused with the reason: latched, not ready, an interlock that does not hold, or asked
        before the last stop. With an arm it goes to its drive pose first, which takes seconds; `told` is called with
        how far it is. It can be given up by arm.hold(), disable(), or a stop."""
        return self._ask(records.ENABLE, told)

    def disable(self) -> str:
        """Disable motion: the wheels stop at once."""
        return self._ask(records.DISABLE)

    def reset(self) -> str:
        """Clear the latched stop; motion stays disabled until enable(). With nothing latched it changes nothing. Raises
        Refused."""
        return self._ask(records.RESET)

    def limit_speed(self, share: float) -> str:
        """Allow every driver this share of the settings' speeds, 0.05 to 1, until another is set or the service ends.
        It counts at once, by the ramps. Raises Refused, ValueError."""
        return self._ask(records.LIMIT, prepare=limiting(share))

    def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """Wait until the state is so, and return it: a word (failstop.api.waiting), or what a function of the state
        says. A service that is not there is waited for too, unless this Robot is of one run. Raises TimedOut, which
        says what is the case and what to do, and ValueError for a word that there is not."""
        return sleep_through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> Iterator[Event]:
        """What the service tells people, as it happens: stops, deaths, requests (docs/journal.md). Waits for the next
        one without end. `past`: first what the run has told so far, the last 256. Raises NoService when this run of the
        service has ended."""
        log = EventLog(self.name)
        if not past:
            log.skip()
        return (event for event in log.follow(LOOK_EVERY_S) if event)


__all__ = ["FailstopError", "Refused", "Robot", "State"]

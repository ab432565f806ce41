"""Robot: drive and stop a robot from Python."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import weakref
from math import isfinite
from types import TracebackType

from failstop.api.arm import Arm
from failstop.api.client import Client, gone, runtime_dir, send_stop
from failstop.api.driving import Answer, Blocked, judge, settled
from failstop.api.errors import FailstopError, NoService, Refused
from failstop.api.events import LOOK_EVERY_S, Event, EventLog
from failstop.api.run import Run
from failstop.api.samples import Sample, SampleReader
from failstop.api.snapshot import Block, State
from failstop.api.state import StateReader
from failstop.api.waiting import POLL_S, Turn, ask, limiting, reach, sleep_through
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE
from failstop.shm import records
from failstop.shm.instance import DEFAULT_NAME
from failstop.shm.records import cut

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from failstop.api.aio import AsyncRobot
    from failstop.api.attend import Attendance
    from failstop.api.waiting import Word
    from failstop.api.why import Why

ANSWER_S = 1.0
"""How long a request may take; the gate answers within a tick."""
MOST_OF_A_NAME = 64
"""Bytes of an operator's name; the rest is left out."""
TAKEN_S = 0.01
"""How long drive() waits for a gate that has not taken this command yet, or may decide otherwise for it; the gate needs
0.3 ms on a machine that is idle."""
CLOSING_S = 0.3
"""How long the end of a Robot waits for motion to be disabled."""


class Robot:
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

    def __init__(
        self,
        name: str = DEFAULT_NAME,
        *,
        client: str | None = None,
        reconnect: bool = True,
        answer_s: float = ANSWER_S,
        disable_on_exit: bool = True,
    ) -> None:
        """`client` is what others see of this program; by default its file name. `answer_s`: how long the gate may take
        to answer a request. `disable_on_exit`: who enabled motion by this Robot takes it back at its end, by leaving
        `with` or by close(); False leaves it enabled for other programs.

        Raises NoService when no service runs, FailstopError for a name that can't be one. What else keeps this program
        from driving or from reading the state, such as a service of another version, is raised by those calls: it keeps
        nobody from estop()."""
        self.name = name
        self.client_name = client or os.path.basename(sys.argv[0]) or "python"
        self._reconnect = reconnect
        self._answer_s = answer_s
        self._lock = threading.RLock()  # a signal's handler may call what it has interrupted
        self._closed = False
        self._closing = False
        self._disable_on_exit = disable_on_exit
        self._enabled = False
        """By this Robot."""
        self._pending: Turn | None = None
        """Whose request the gate has not answered yet."""
        self._run: Run | None = None
        self._state_reader: StateReader | None = None
        self._samples: SampleReader | None = None
        self._connected: Client | None = None
        self._arm: Arm | None = None
        _made.add(self)
        runtime_dir(name)
        with contextlib.suppress(FailstopError):
            self._run = Run(name)

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

        given = cls(name, client=client, reconnect=reconnect, answer_s=answer_s, disable_on_exit=disable_on_exit)
        return AsyncRobot(given)

    def close(self) -> None:
        """Give the client slot back, for good. If this program was driving, the wheels stop at once, and no command of
        this Robot reaches the service any more. Motion that it enabled is disabled (`disable_on_exit`)."""
        self._close(in_order=True)

    def _close(self, *, in_order: bool) -> None:
        with self._lock:
            if self._closed:
                return
            self._closed = self._closing = True
        try:
            if self._enabled and self._disable_on_exit and self._connected:
                # Whatever keeps it from being disabled keeps nobody from closing; the wheels stop by that too.
                with contextlib.suppress(FailstopError):
                    sleep_through(ask(self, records.DISABLE, min(self._answer_s, CLOSING_S)))
        finally:
            with self._lock:
                self._closing = False
                self._leave(in_order=in_order)
                self._run = None

    @property
    def closed(self) -> bool:
        """After close(), or when `with` was left."""
        return self._closed

    @property
    def reconnects(self) -> bool:
        """It goes over to the next run of the service (`reconnect`)."""
        return self._reconnect

    def release(self) -> None:
        """Give the client slot back until a call needs one again. If this program was driving, the wheels stop at
        once."""
        with self._lock:
            self._check_open()
            self._leave()

    def _leave(self, *, in_order: bool = True) -> None:
        connected, self._connected = self._connected, None
        if connected:
            connected.close(in_order=in_order)

    def _check_open(self) -> None:
        """What the end of this Robot still asks is asked (`_closing`)."""
        if self._closed and not self._closing:
            raise FailstopError(f"this Robot of {self.name!r} is closed: make a new one")

    def _current(self) -> Run:
        """The run that is there now. When it is over, and its last processes are ending, its state can still be read.
        Raises NoService, FailstopError."""
        self._check_open()
        run = self._run
        if run is None or run.over():
            run = self._run = self._renewed()
        return run

    def _renewed(self) -> Run:
        self._leave()
        found = Run(self.name)
        if self._run and not self._reconnect:
            became = "has ended" if found.incarnation == self._run.incarnation else "was restarted"
            raise NoService(f"the service {self.name!r} {became} since this Robot was made: make a new one")
        return found

    def _slot(self, run: Run) -> Client:
        if self._connected is None:
            if run.over():
                raise gone(self.name)
            self._connected = Client(self.name, self.client_name)
        connected = self._connected
        if self._closed and not self._closing:  # by a signal's handler, while this went on
            self._leave()
            self._check_open()
        return connected

    def _client(self) -> Client:
        return self._slot(self._current())

    def _forked(self) -> None:
        """In the child of a fork: the slot is the parent's, and who holds the lock is not known."""
        self._lock = threading.RLock()
        self._pending = None
        self._enabled = False
        self._leave(in_order=False)

    def _ask(
        self, verb: int, told: Callable[[str], None] | None = None, prepare: Callable[[Client], None] | None = None
    ) -> str:
        return sleep_through(ask(self, verb, self._answer_s, told, prepare))

    def enable(self, told: Callable[[str], None] | None = None) -> str:
        """Enable motion. Raises Refused with the reason: latched, not ready, an interlock that does not hold, or asked
        before the last stop. With an arm it goes to its drive pose first, which takes seconds; `told` is called with
        how far it is. It can be given up by arm.hold(), disable(), or a stop."""
        return self._ask(records.ENABLE, told)

    @property
    def arm(self) -> Arm:
        """The robot's arm. Raises FailstopError where the settings name none."""
        if self._arm is None:
            self._arm = Arm(self)
        return self._arm

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

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = DEFAULT_SOURCE) -> Answer:
        """Command a velocity: m/s forward, m/s left, rad/s counter-clockwise. It holds for its source's timeout (0.3
        s unless the settings say otherwise, 2 s at most), so repeat it. Values past the limits are clamped. After a
        restart of the service nothing moves before somebody enables motion again.

        Returns what becomes of it: Driving, Preempted by whom, or Blocked by what; only Driving is true in a condition.
        It takes no time while the wheels turn, and 10 ms at most while they do not.

        A command by a person (`manual`) is exempt from the scan gate. `source` is a name of the settings' [sources].
        Raises ValueError for a value that is not finite, Undeclared (a ValueError too) for a source that the settings
        do not name, NoService when no service runs.
        """
        if not (isfinite(vx) and isfinite(vy) and isfinite(wz)):
            raise ValueError(f"drive({vx}, {vy}, {wz}): every value must be finite")
        with self._lock:
            run = self._current()
            run.check_source(source)
            self._slot(run).command(vx, vy, wz, manual=manual, source=source)
        until_s = time.monotonic() + TAKEN_S
        while (answer := self._answer(source)) is None or not settled(answer):
            if time.monotonic() > until_s:
                return Blocked(Block.NO_COMMAND, "the gate has not taken the command yet") if answer is None else answer
            time.sleep(POLL_S)
        return answer

    def _answer(self, source: str) -> Answer | None:
        with self._lock:
            decided, cause = self._reader.decided()
        return judge(decided, decided["sources"], source, str(cause or ""))

    def sensed(self) -> None:
        """The obstacle sensor delivered just now. Software commands move the wheels only while somebody says so at
        least every 0.5 s (setting scan.timeout_s); else they are blocked with `no scan`. Raises NoService when no
        service runs."""
        with self._lock:
            self._client().sensed()

    def hold(self, *interlocks: str) -> None:
        """These interlocks hold now (names of the settings' [interlocks]); repeat it within their timeout.

        Enabling needs every declared one, and losing one disables motion. What an earlier call named and this one does
        not is no longer asserted, and ends with its timeout. Raises Undeclared for one that the settings do not name,
        and then asserts none; NoService when no service runs.
        """
        with self._lock:
            run = self._current()
            run.check_interlocks(interlocks)
            self._slot(run).hold(list(interlocks))

    def attend(self, who: str) -> Attendance:
        """An operator attends, once the attendance that comes back is renewed, and for as long as it is (see there).
        Where the setting attend.required is "on", motion needs somebody who attends; elsewhere it changes nothing."""
        from failstop.api.attend import Attendance

        return Attendance(self, cut(" ".join(who.split()), MOST_OF_A_NAME).decode() or "somebody")

    def _attended(self, who: str, t_ns: int) -> None:
        with self._lock:
            self._client().attended(who, t_ns)

    def say(self, sees: str, wrong: str = "") -> None:
        """Tell people in a line what this program sees, and what is wrong, if anything is: `status`, `why`, `doctor`
        and the events show it under the program's name, the newest words only. At most 190 bytes each; say it again
        every few seconds, as old words are shown with their age."""
        with self._lock:
            self._client().say(sees, wrong)

    def estop(self, reason: str = "") -> None:
        """Latched protective stop (a stop by software, category 2; not an emergency stop in the sense of ISO 13850).
        Motion stays off until reset() and enable(). Anyone may, with a service of any version, and with a Robot that is
        closed; raises NoService when nothing is there to stop. The latch's reason is `stop request: REASON (CLIENT, pid
        N)`; of a reason of more than 180 bytes the rest is left out."""
        send_stop(self.name, reason, self.client_name)

    @property
    def _reader(self) -> StateReader:
        run = self._current()
        if self._state_reader is None or self._state_reader.run is not run:
            self._state_reader = StateReader(self.name, run)
        return self._state_reader

    @property
    def state(self) -> State:
        """One snapshot of the service. When its supervisor has just died it says so, as a latched stop; raises
        NoService once the last of its processes has ended, FailstopError while it starts."""
        with self._lock:
            return self._reader.read()

    def why(self) -> Why:
        """What holds the wheels, what proof there is that they stand, and what to do. `str` of it is the three lines
        that `failstop why` prints. Raises NoService, FailstopError."""
        from failstop.api.why import explain  # nobody who drives needs its words

        return explain(self.state, EventLog(self.name).read(), time.time())

    def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """Wait until the state is so, and return it: a word (failstop.api.waiting), or what a function of the state
        says. A service that is not there is waited for too, unless this Robot is of one run. Raises TimedOut, which
        says what is the case and what to do, and ValueError for a word that there is not."""
        return sleep_through(reach(self, what, timeout_s))

    def events(self, *, past: bool = False) -> Iterator[Event]:
        """What the service tells people, as it happens: stops, deaths, requests (docs/journal.md). Waits for the next
        one without end. `past`: first what the run has told so far, the last 256. Raises NoService when this run of the
        service has ended."""
        log = EventLog(self.name)
        if not past:
            log.skip()
        return (event for event in log.follow(LOOK_EVERY_S) if event)

    @property
    def settings(self) -> dict[str, float | str]:
        """Every setting that the service was started with, by its whole key (`failstop config` lists them). Raises
        FailstopError."""
        with self._lock:
            return self._reader.settings()

    def samples(self) -> list[Sample]:
        """What the board reported since the last call, each sample once with its time: ImuSample, BatterySample,
        PadSample, OdometrySample of failstop.api.samples. The first call begins it, and the first of a new run begins
        again. Raises NoService, FailstopError."""
        with self._lock:
            run = self._current()
            if self._samples is None or self._samples.run is not run:
                self._samples = SampleReader(self.name, run)
            return self._samples.read()


_made: weakref.WeakSet[Robot] = weakref.WeakSet()


def _after_fork() -> None:
    for robot in tuple(_made):
        robot._forked()


os.register_at_fork(after_in_child=_after_fork)

__all__ = ["FailstopError", "Refused", "Robot", "State"]

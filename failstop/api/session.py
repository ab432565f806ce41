"""Session: a program's connection to the service of one name: which run of it, the client slot, the requests."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import weakref
from contextlib import closing

from failstop.api import waiting
from failstop.api.client import Client, gone, runtime_dir
from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused, TimedOut
from failstop.api.news import News
from failstop.api.run import Run
from failstop.api.state import StateReader
from failstop.api.waiting import LOOK_S, POLL, Steps, sleep_through
from failstop.shm import records
from failstop.shm.instance import DEFAULT_NAME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.api.snapshot import State
    from failstop.api.waiting import Word

    Told = Callable[[str], None] | None
    Prepare = Callable[[Client], None] | None

ANSWER_S = 1.0
"""How long a request may take; the gate answers within a tick."""
CLOSING_S = 0.3
"""How long the end of a session waits for motion to be disabled."""


class Turn:
    """A place in the queue of a session's requests."""

    def __init__(self, task: object, asked_ns: int = 0) -> None:
        """`task`: of an event loop, that awaits its turn; None: the thread itself waits, and its tasks with it."""
        self.thread = threading.get_ident()
        self.task = task
        self.asked_ns = asked_ns or time.monotonic_ns()
        """A stop that comes while it waits for its turn is one that its caller did not know of."""


class Session:
    """What Robot and AsyncRobot have in common beneath their calls. Thread-safe."""

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
        self._connected: Client | None = None
        _made.add(self)
        runtime_dir(name)
        with contextlib.suppress(FailstopError):
            self._run = Run(name)

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
                    sleep_through(self._asking(records.DISABLE, answer_s=min(self._answer_s, CLOSING_S)))
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

    @property
    def settings(self) -> dict[str, float | str]:
        """Every setting that the service was started with, by its whole key (`failstop config` lists them). Raises
        FailstopError."""
        with self._lock:
            return self._reader.settings()

    def _attended(self, who: str, t_ns: int) -> None:
        with self._lock:
            self._client().attended(who, t_ns)

    # Requests.

    def _ask(self, verb: int, told: Told = None, prepare: Prepare = None, asked_ns: int = 0) -> str:
        """Make a request, and wait for its answer."""
        return sleep_through(self._asking(verb, told, prepare, asked_ns=asked_ns))

    def _asking(
        self,
        verb: int,
        told: Told = None,
        prepare: Prepare = None,
        answer_s: float | None = None,
        task: object = None,
        asked_ns: int = 0,
    ) -> Steps[str]:
        """One request to the gate, until it is answered. The gate keeps one request of a client, and its answer, so
        those of several threads or tasks go one after the other; one that is under way, such as an arm's move, lets
        others pass, which is how it is given up. `told` is called with each word of how far it is, where that takes
        time; `prepare`: what the gate finds with the request; `asked_ns`: when it was asked for, if not now. Raises
        Refused, NoAnswer, NoService, FailstopError."""
        turn, said = Turn(task, asked_ns), ""
        limit_s = self._answer_s if answer_s is None else answer_s
        try:
            while not (sent := self._send(verb, turn, prepare)):
                yield POLL
            client, run, number = sent
            until_s = time.monotonic() + limit_s
            while not (answer := client.answer(number)) or answer.done == records.UNDER_WAY:
                if answer and answer.text != said:
                    said, until_s = answer.text, time.monotonic() + limit_s
                    self._pass(turn)
                    if told:
                        told(said)
                with self._lock:
                    self._check_open()
                    if run.over():
                        raise gone(self.name)
                if time.monotonic() > until_s:
                    text = f"the gate of {self.name!r} did not answer within {limit_s:g} s: see `failstop status`"
                    raise NoAnswer(text)
                yield POLL
            if not answer.done:
                raise Refused(answer.text, answer.cause)
            if verb in (records.ENABLE, records.DISABLE):
                self._enabled = verb == records.ENABLE
            return str(answer)
        finally:
            self._pass(turn)

    def _send(self, verb: int, turn: Turn, prepare: Prepare) -> tuple[Client, Run, int] | None:
        """By whom, in which run, under which number; None while another thread's or task's is on its way. A signal's
        handler goes before what it has interrupted, and so does a thread before its tasks."""
        with self._lock:
            before = self._pending
            if before and (before.thread != turn.thread or turn.task not in (None, before.task)):
                self._check_open()
                return None
            run = self._current()
            client = self._slot(run)
            self._pending = turn
            if prepare:
                prepare(client)
            return client, run, client.ask(verb, turn.asked_ns)

    def _pass(self, turn: Turn) -> None:
        """Let the next one pass."""
        with self._lock:
            if self._pending is turn:
                self._pending = None

    def _reaching(self, what: Word | Callable[[State], bool], timeout_s: float | None) -> Steps[State]:
        """Until the state is so; it is what comes of it. Raises TimedOut, NoService, and ValueError for a word that
        there is not."""
        is_so = waiting.check(what)
        name = getattr(what, "__name__", "that") if callable(what) else what
        until_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        with closing(News(self.name)) as news:
            while True:
                news.look()
                late, state = time.monotonic() >= until_s, None
                try:
                    state = self.state
                except FailstopError as error:
                    wrong = isinstance(error, NoService) and not self.reconnects
                    if late or wrong or self.closed:
                        raise
                if state and is_so(state):
                    return state
                if late and timeout_s is not None:
                    raise TimedOut(waiting.late(name, timeout_s, state))
                yield news, min(LOOK_S, max(0.0, until_s - time.monotonic()))


_made: weakref.WeakSet[Session] = weakref.WeakSet()


def _after_fork() -> None:
    for session in tuple(_made):
        session._forked()


os.register_at_fork(after_in_child=_after_fork)

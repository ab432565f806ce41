"""Session: a program's connection to one service, with the client slot and the requests.

A call that takes time is a generator that yields whenever it must wait. At each yield, Robot lets the whole thread
sleep, and AsyncRobot lets only the task sleep.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Generator
from math import inf
from typing import Any, Literal, TypeVar, get_args

from failstop.api import steps, verdict, words
from failstop.api.client import Client, SeenRun, gone, runtime_dir
from failstop.api.errors import FailstopError, NoAnswer, Refused, TimedOut
from failstop.api.events import LOOK_S, EventLog
from failstop.api.snapshot import State
from failstop.api.state import StateReader
from failstop.api.steps import Purpose
from failstop.files.instance import DEFAULT_NAME
from failstop.messages import records
from failstop.policy import causes
from failstop.policy.causes import Reply

T = TypeVar("T")
Steps = Generator[float, None, T]
"""A call that takes time, as a generator. Whenever it must wait, it yields the number of seconds to wait."""
Progress = Callable[[str], None] | None
Word = Literal["ready", "enabled", "disabled", "latched", "clear", "moving", "standing", "still"]
"""The words that `Robot.wait_for` accepts.

- ready: every process is running, and the next request would succeed. The next request is `reset()` if a stop is
  latched, and otherwise `enable()`.
- enabled: motion is enabled.
- disabled: motion is disabled.
- latched: a stop is latched.
- clear: no stop is latched.
- moving: the gate commands a velocity.
- standing: the gate commands no velocity.
- still: the gate commands no velocity, and a reading shows that the wheels are still. The reading must be from after
  the time when the wheels were last stopped.
"""

ANSWER_S = records.ANSWER_WITHIN_NS / 1e9
"""How long to wait for the answer to a request, in seconds. The gate normally answers within a tick."""
POLL_S = 0.0003


def pause_s(begun_s: float) -> float:
    """How long to sleep before checking again for an answer, in seconds. The pauses get longer with the wait.
    `begun_s`: when the wait began (time.monotonic())."""
    return min(max(POLL_S, (time.monotonic() - begun_s) / 8), LOOK_S)


def _ready(state: State) -> bool:
    """True if every process is running and the next request would succeed. The next request is reset() if a stop is
    latched, and otherwise enable()."""
    if any(process.state != "running" for process in state.processes.values()) or state.waiting_for:
        return False
    if state.cause:
        return state.cause.kind.cleared_by == causes.A_RESET
    return not steps.before(state, Purpose.ENABLE)


_CHECKS: dict[str, Callable[[State], bool]] = {
    "ready": _ready,
    "enabled": lambda state: state.enabled,
    "disabled": lambda state: not state.enabled,
    "latched": lambda state: state.cause is not None,
    "clear": lambda state: state.cause is None,
    "moving": lambda state: state.moving,
    "standing": lambda state: not state.moving,
    "still": lambda state: not state.moving,  # what was seen of the wheels needs the events (_seen_still)
}
assert _CHECKS.keys() == set(get_args(Word))


DISABLE_FIRST = "`failstop disable`, or robot.disable(), because the arm moves only while motion is disabled"
"""The next step for people if a request about the arm was refused because the wheels may turn."""


def own_name() -> str:
    """Return the file name of this program, or `python` if Python reads it from standard input or from `-c`."""
    name = os.path.basename("".join(sys.argv[:1]))
    return name if name not in ("", "-", "-c") else "python"


class Session:
    """The part of Robot and AsyncRobot that connects to the service. Thread-safe."""

    def __init__(
        self,
        name: str = DEFAULT_NAME,
        *,
        client: str | None = None,
        answer_s: float = ANSWER_S,
        disable_on_exit: bool = True,
    ) -> None:
        """Connect to the service `name`. `client`: the name under which others see this program, by default its file
        name. `answer_s`: how long to wait for the gate's answer to a request. `disable_on_exit`: True to disable motion
        at close() or at the end of the `with` block, but only if this Robot has enabled it. Motion that was disabled or
        stopped since, and then enabled by somebody else, stays enabled. With False, motion stays enabled for other
        programs.

        Raises NoService when no service is running, FailstopError for an invalid name. Other errors, such as a
        different version of the service, are raised only by calls that drive or read the state, so that estop() works
        anyway.
        """
        self.name = name
        self.client_name = client or own_name()
        self._answer_s = answer_s
        self._disable_on_exit = disable_on_exit
        self._lock = threading.RLock()  # reentrant, because a signal handler may call a method that it has interrupted
        self._closed = False
        self._enabled = False
        """True if this Robot has enabled motion. If the answer to enable() does not arrive, this is True too, because
        the gate may have enabled motion."""
        self._own_motion: tuple[str, int] | None = None
        """What _motion() returned when this Robot had enabled motion."""
        self._pending: tuple[int, object] | None = None
        """(thread, task) that waits for the gate's answer to a request. `thread` is the thread's id. `task` is an
        object that stands for a task of an event loop, or None if the whole thread waits. None if nobody waits."""
        self._run: StateReader | None = None
        self._connected: Client | None = None
        _made.add(self)
        runtime_dir(name)
        with contextlib.suppress(FailstopError):
            self._run = StateReader(name)

    def close(self) -> None:
        """Give the client slot back for good. If this program was driving, the wheels stop at once. If this Robot has
        enabled motion, motion is disabled (unless `disable_on_exit` is False). After close(), no command of this Robot
        reaches the service."""
        self._close(in_order=True)

    def _close(self, *, in_order: bool) -> None:
        try:
            # Close even if disabling fails, because closing stops the wheels too.
            with contextlib.suppress(FailstopError):
                if self._disables_at_end(in_order=in_order):
                    sleep_through(self._asking(records.DISABLE))
        finally:
            self._end(in_order=in_order)

    def _disables_at_end(self, *, in_order: bool) -> bool:
        """True if this Robot must disable motion at its end, because it has enabled it. False if the program chose
        disable_on_exit=False, or if somebody else has enabled motion since. `in_order`: False if the program dies of an
        exception. If that program has driven, the gate itself ends the motion and reports which driver has died, so the
        answer is False. But the gate leaves motion enabled if the setting gate.driver_death is "stay", so with that
        setting the answer is True. Raises FailstopError."""
        connected = self._connected
        if not (self._enabled and self._disable_on_exit and connected):
            return False
        if own := self._own_motion:
            with contextlib.suppress(FailstopError):  # then nobody knows, so it is disabled
                if (now := self._motion()) and now != own:
                    return False
        return in_order or not connected.drove or self.settings["gate.driver_death"] == "stay"

    def _motion(self) -> tuple[str, int] | None:
        """Identify the motion that is enabled at present, as (the run's name in shared memory, when it was enabled in
        ns). Somebody who enables motion again gets another time. None if motion is disabled, and also while the
        supervisor is silent. Raises NoService, FailstopError."""
        with self._lock:
            run = self._current()
            enabled_ns = run.decided()[0].get("enabled_ns")
            return (run.found[0], enabled_ns) if enabled_ns else None

    def _end(self, *, in_order: bool) -> None:
        """Give the client slot back, for good."""
        with self._lock:
            self._closed = True
            self._leave(in_order=in_order)
            self._run = None

    def _leave(self, *, in_order: bool = True) -> None:
        connected, self._connected = self._connected, None
        if connected:
            connected.close(in_order=in_order)

    def _check_open(self) -> None:
        if self._closed:
            raise FailstopError(f"this Robot of {self.name!r} is closed: make a new one")

    def _current(self) -> StateReader:
        """The service's present run. After its supervisor has died, the run's state can still be read until its other
        processes have ended. Raises NoService, FailstopError."""
        self._check_open()
        run = self._run  # kept in a variable, because a signal handler may close this object meanwhile
        if run is None or run.over():
            self._leave()
            run = self._run = StateReader(self.name)
        return run

    def _slot(self, run: SeenRun) -> Client:
        connected = self._connected
        if connected is None:
            if run.over():
                raise gone(self.name)
            connected = self._connected = Client(self.name, self.client_name)
        if self._closed:  # a signal handler has closed this object meanwhile
            self._leave()
            self._check_open()
        return connected

    def _client(self) -> Client:
        return self._slot(self._current())

    def _forked(self) -> None:
        """Drop the client slot and the lock in the child after a fork. The slot belongs to the parent, and a thread
        that does not exist in the child may hold the lock."""
        self._lock = threading.RLock()
        self._pending = None
        self._enabled = False
        self._leave(in_order=False)

    @property
    def state(self) -> State:
        """The state of the service at this moment. If its supervisor has just died, the state shows that as a latched
        stop. Raises NoService once the last process of the service has ended. Raises FailstopError if the state can't
        be read."""
        with self._lock:
            return self._current().read()

    @property
    def settings(self) -> dict[str, float | str]:
        """Every setting of the service, by its full key (`failstop config` lists them). Raises FailstopError."""
        with self._lock:
            return self._current().settings()

    def _asking(
        self,
        verb: int,
        progress: Progress = None,
        about: tuple[Any, ...] = (),
        *,
        asked_ns: int = 0,
        awaited: bool = False,
    ) -> Steps[str]:
        """Send one request to the gate, and wait for the answer.

        The gate keeps only the newest request of each client, so several threads or tasks send theirs one after the
        other. While a long request such as a move of the arm is under way, others may be sent, because one of them may
        be meant to end the move.

        `progress`: called with each text about the progress. `about`: the name and the values of a record that must be
        written before the request. `asked_ns`: when the request was made, by default now. After a stop since then, the
        service refuses a reset and any request that could start motion, because the caller did not know about that
        stop. `awaited`: True if only a task of an event loop waits; False if the whole thread waits, with all tasks in
        it. Raises Refused, NoAnswer, NoService, FailstopError.
        """
        turn, said, begun_s = (threading.get_ident(), object() if awaited else None), "", time.monotonic()
        asked_ns = asked_ns or time.monotonic_ns()
        try:
            while not (sent := self._send(verb, turn, about, asked_ns)):
                yield pause_s(begun_s)
            client, run, number = sent
            before, until_s = (self._enabled, self._own_motion), time.monotonic() + self._answer_s
            if verb == records.ENABLE:
                # The gate may enable motion even if the answer does not arrive.
                self._enabled, self._own_motion = True, None
            while not (answer := client.answer(number)) or answer.done == records.UNDER_WAY:
                if answer and answer.text != said:
                    said, until_s = answer.text, time.monotonic() + self._answer_s
                    self._pass(turn)
                    if progress:
                        progress(said)
                with self._lock:
                    self._check_open()
                    if run.over():
                        raise gone(self.name)
                if time.monotonic() > until_s:
                    raise self._unanswered()
                yield pause_s(begun_s)
            if not answer.done:
                if verb == records.ENABLE:
                    self._enabled, self._own_motion = before
                raise self._refused(verb, answer)
            if verb == records.ENABLE:
                with contextlib.suppress(FailstopError):
                    self._own_motion = self._motion()
            if verb == records.DISABLE:
                self._enabled = False
            return str(answer)
        finally:
            self._pass(turn)

    def _unanswered(self) -> NoAnswer:
        """Make the error for a request that the gate did not answer in time. If the gate is down, the message says when
        it will start again."""
        why = ""
        with contextlib.suppress(FailstopError):
            why = verdict.no_answer(self.state)
        what = f"the gate of {self.name!r} did not answer within {self._answer_s:g} s"
        return NoAnswer(f"{what}: {why or words.named('see `failstop status`', self.name)}")

    def _refused(self, verb: int, answer: Reply) -> Refused:
        """Make the error for a request that the gate refused, with the next step for people."""
        step = words.named(DISABLE_FIRST, self.name) if answer.refused_for == records.FOR_THE_WHEELS else ""
        if verb in (records.ENABLE, records.RESET) or answer.cause:
            goal = Purpose.RESET if verb == records.RESET else Purpose.ENABLE
            with contextlib.suppress(FailstopError):  # if the service is ending, there is no next step
                step = steps.after_refusal(self.state, goal, known=answer.refused_for == records.FOR_AN_INTERLOCK)
        return Refused(words.named(answer.text, self.name), answer.cause, step, answer.refused_for)

    def _send(
        self, verb: int, turn: tuple[int, object], about: tuple[Any, ...], asked_ns: int
    ) -> tuple[Client, SeenRun, int] | None:
        """Send a request, and return the client, the run and the request's number. Return None if this request must
        wait for its turn, because another thread or task is waiting for an answer. A request never waits for code that
        it blocks itself. So the request of a signal handler does not wait for the interrupted code, and a request that
        blocks its whole thread does not wait for the tasks in that thread."""
        with self._lock:
            if self._pending:
                thread, task = self._pending
                if thread != turn[0] or turn[1] not in (None, task):
                    self._check_open()
                    return None
            run = self._current()
            client = self._slot(run)
            self._pending = turn
            if about:
                client.write(*about)
            return client, run, client.ask(verb, asked_ns)

    def _pass(self, turn: tuple[int, object]) -> None:
        """Let another thread or task send its request. `turn`: the thread or task whose turn is over."""
        with self._lock:
            if self._pending == turn:
                self._pending = None

    def _reaching(self, what: Word | Callable[[State], bool], timeout_s: float | None) -> Steps[State]:
        """Wait until the state is reached, and return it. Raises TimedOut, NoService, or ValueError for an unknown
        word."""
        is_so = what if callable(what) else _CHECKS.get(what)
        if is_so is None:
            raise ValueError(f"wait_for({what!r}): unknown word; choose from {', '.join(_CHECKS)}")
        name = getattr(what, "__name__", "that") if callable(what) else what
        limit_s = inf if timeout_s is None else timeout_s
        until_s = time.monotonic() + limit_s
        while True:
            late = time.monotonic() >= until_s
            try:
                state = self.state
                shown = what != "still" or self._seen_still(state)
            except FailstopError:
                if late or self._closed:
                    raise
            else:
                if shown and is_so(state):
                    return state
                if late:
                    step = steps.line(state)
                    text = f"waited {limit_s:g} s for {name!r}: {verdict.headline(state)}"
                    raise TimedOut(text + (f"; next: {step}" if step else ""))
            yield min(LOOK_S, max(0.0, until_s - time.monotonic()))

    def _seen_still(self, state: State) -> bool:
        """True if the wheels were seen still since they were last stopped. Raises NoService, FailstopError."""
        if state.turning.does != "still":
            return False
        from failstop.api import dates  # imported only here, because driving does not need it

        at = dates.now()
        seen = verdict.seen_since(*dates.dated(state, EventLog(self.name, past=True).read(), at), at.unix_s)
        return seen.turning.does == "still"


def sleep_through(steps: Steps[T]) -> T:
    """Run a generator of steps, sleep as long as each step asks for, and return the result."""
    try:
        while True:
            time.sleep(next(steps))
    except StopIteration as done:
        found: T = done.value
        return found
    finally:
        steps.close()


_made: weakref.WeakSet[Session] = weakref.WeakSet()


def _after_fork() -> None:
    for session in tuple(_made):
        session._forked()


os.register_at_fork(after_in_child=_after_fork)

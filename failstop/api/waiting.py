"""Waiting: what a Robot waits for, as steps between which whoever waits sleeps - a thread here, a task in aio.py."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator
from contextlib import closing
from typing import Literal, TypeVar, get_args

from failstop.api import verdict
from failstop.api.client import gone
from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused, TimedOut
from failstop.api.news import News
from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.api.client import Client
    from failstop.api.robot import Robot
    from failstop.api.run import Run
    from failstop.api.snapshot import State

T = TypeVar("T")
Steps = Generator[tuple["News | None", float], None, T]
"""Each step: what wakes early, if anything does, and for how long to sleep, s."""

LOOK_S = 0.02
"""Time between two looks without news: what is told to people wakes who waits, and a velocity is no such thing."""
POLL_S = 0.0003
POLL = (None, POLL_S)
Word = Literal["ready", "enabled", "disabled", "latched", "clear", "moving", "standing", "still"]
"""What `Robot.wait_for` takes: ready (motion could be enabled or reset), enabled, disabled, latched (a stop is), clear
(none is), moving and standing (what the gate commands), still (the IMU has seen the wheels still since the last
stop)."""

_CHECKS: dict[str, Callable[[State], bool]] = {
    "ready": lambda state: state.waiting_for is None and not verdict.down(state),
    "enabled": lambda state: state.enabled,
    "disabled": lambda state: not state.enabled,
    "latched": lambda state: state.cause is not None,
    "clear": lambda state: state.cause is None,
    "moving": lambda state: state.moving,
    "standing": lambda state: not state.moving,
    "still": lambda state: bool(state.last_stop and state.last_stop.observed_s is not None),
}
assert _CHECKS.keys() == set(get_args(Word))


def sleep_through(steps: Steps[T]) -> T:
    """Take the steps, asleep in between; returns what they come to, and raises what they raise."""
    try:
        while True:
            news, for_s = next(steps)
            if news:
                news.wait(for_s)
            else:
                time.sleep(for_s)
    except StopIteration as done:
        found: T = done.value
        return found
    finally:
        steps.close()


class Turn:
    """A thread's place in the queue of a Robot's requests."""

    def __init__(self) -> None:
        self.thread = threading.get_ident()


def ask(
    robot: Robot,
    verb: int,
    answer_s: float,
    told: Callable[[str], None] | None = None,
    prepare: Callable[[Client], None] | None = None,
) -> Steps[str]:
    """One request to the gate, until it is answered. The gate keeps one request of a client, and its answer, so those
    of several threads go one after the other; one that is under way, such as an arm's move, lets others pass, which is
    how it is given up. `told` is called with each word of how far it is, where that takes time; `prepare`: what the
    gate finds with the request. Raises Refused, NoAnswer, NoService, FailstopError."""
    turn, said = Turn(), ""
    try:
        while not (sent := _send(robot, verb, turn, prepare)):
            yield POLL
        client, run, number = sent
        until_s = time.monotonic() + answer_s
        while not (answer := client.answer(number)) or answer.done == records.UNDER_WAY:
            if answer and answer.text != said:
                said, until_s = answer.text, time.monotonic() + answer_s
                _leave(robot, turn)
                if told:
                    told(said)
            with robot._lock:
                robot._check_open()
                if run.over():
                    raise gone(robot.name)
            if time.monotonic() > until_s:
                text = f"the gate of {robot.name!r} did not answer within {answer_s:g} s: see `failstop status`"
                raise NoAnswer(text)
            yield POLL
        if not answer.done:
            raise Refused(answer.text, answer.cause)
        if verb in (records.ENABLE, records.DISABLE):
            robot._enabled = verb == records.ENABLE
        return str(answer)
    finally:
        _leave(robot, turn)


def limiting(share: float) -> Callable[[Client], None]:
    """What the gate finds with a request to limit the speed. Raises ValueError for a share that is no percentage of a
    speed."""
    if not 0.0 < share <= 1.0:
        raise ValueError(f"a speed limit of {share}: must be over 0, and at most 1")
    return lambda client: client.speed_limit(round(100 * share))


def _send(
    robot: Robot, verb: int, turn: Turn, prepare: Callable[[Client], None] | None
) -> tuple[Client, Run, int] | None:
    """By whom, in which run, under which number; None while another thread's is on its way. A signal's handler goes
    before what it has interrupted."""
    with robot._lock:
        before = robot._pending
        if before and before.thread != turn.thread:
            robot._check_open()
            return None
        run = robot._current()
        client = robot._slot(run)
        robot._pending = turn
        if prepare:
            prepare(client)
        return client, run, client.ask(verb)


def _leave(robot: Robot, turn: Turn) -> None:
    """Let the next one pass."""
    with robot._lock:
        if robot._pending is turn:
            robot._pending = None


def reach(robot: Robot, what: Word | Callable[[State], bool], timeout_s: float | None) -> Steps[State]:
    """Until the state is so; it is what comes of it. Raises TimedOut, NoService, and ValueError for a word that there
    is not."""
    is_so = what if callable(what) else _CHECKS.get(what)
    if is_so is None:
        raise ValueError(f"wait_for({what!r}): no such word; there are {', '.join(_CHECKS)}")
    name = getattr(what, "__name__", "that") if callable(what) else what
    until_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
    with closing(News(robot.name)) as news:
        while True:
            news.look()
            late, state = time.monotonic() >= until_s, None
            try:
                state = robot.state
            except FailstopError as error:
                wrong = isinstance(error, NoService) and not robot.reconnects
                if late or wrong or robot.closed:
                    raise
            if state and is_so(state):
                return state
            if late and timeout_s is not None:
                raise TimedOut(_late(name, timeout_s, state))
            yield news, min(LOOK_S, max(0.0, until_s - time.monotonic()))


def _late(name: str, timeout_s: float, state: State | None) -> str:
    """What is told when it did not come about in time, with what to do."""
    if state is None:
        return f"waited {timeout_s:g} s for {name!r}: the service tells nothing; see `failstop doctor`"
    step = verdict.next_step(state)
    return f"waited {timeout_s:g} s for {name!r}: {verdict.headline(state)}" + (f"; next: {step}" if step else "")

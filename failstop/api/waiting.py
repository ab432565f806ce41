"""Waiting: for a state, without looking at it all the time."""

from __future__ import annotations

import time
from typing import Literal, get_args

from failstop.api import verdict
from failstop.api.errors import FailstopError, NoService, TimedOut
from failstop.api.news import News

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.api.robot import Robot
    from failstop.api.snapshot import State

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


def check(what: Word | Callable[[State], bool]) -> tuple[Callable[[State], bool], str]:
    """The predicate, and its name for people. Raises ValueError."""
    if callable(what):
        return what, getattr(what, "__name__", "that")
    if what not in _CHECKS:
        raise ValueError(f"wait_for({what!r}): no such word; there are {', '.join(_CHECKS)}")
    return _CHECKS[what], what


def _late(name: str, timeout_s: float, state: State | None) -> str:
    """What is told when it did not come about in time, with what to do."""
    if state is None:
        return f"waited {timeout_s:g} s for {name!r}: the service tells nothing; see `failstop doctor`"
    now = verdict.headline(state)
    step = verdict.next_step(state)
    return f"waited {timeout_s:g} s for {name!r}: {now}" + (f"; next: {step}" if step else "")


LOOK_S = 0.02
"""Time between two looks without news: what is told to people wakes who waits, and a velocity is no such thing."""


class Watch:
    """Look until the state is so; a context manager. Between two looks there is sleep_s() to wait for news."""

    def __init__(self, robot: Robot, what: Word | Callable[[State], bool], timeout_s: float | None) -> None:
        """Raises ValueError."""
        self._check, self._name = check(what)
        self._robot = robot
        self._timeout_s = timeout_s
        self._until_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        self.news = News(robot.name)

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.news.close()

    def look(self) -> State | None:
        """The state, if it is so. Raises TimedOut, NoService."""
        self.news.clear()
        self.news.watch()
        late, state = time.monotonic() >= self._until_s, None
        try:
            state = self._robot.state
        except FailstopError as error:
            wrong = isinstance(error, NoService) and not self._robot.reconnects
            if late or wrong or self._robot.closed:
                raise
        if state and self._check(state):
            return state
        if late and self._timeout_s is not None:
            raise TimedOut(_late(self._name, self._timeout_s, state))
        return None

    def sleep_s(self) -> float:
        """How long until the next look is worth it without news."""
        return min(LOOK_S, max(0.0, self._until_s - time.monotonic()))

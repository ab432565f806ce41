"""Waiting: for a state, without looking at it all the time."""

from __future__ import annotations

import time
from typing import Literal, get_args

from failstop.api import verdict
from failstop.api.errors import FailstopError, NoService, TimedOut

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


def late(name: str, timeout_s: float, state: State | None) -> str:
    """What is told when it did not come about in time, with what to do."""
    if state is None:
        return f"waited {timeout_s:g} s for {name!r}: the service tells nothing; see `failstop doctor`"
    now = verdict.headline(state)
    step = verdict.next_step(state)
    return f"waited {timeout_s:g} s for {name!r}: {now}" + (f"; next: {step}" if step else "")


LOOK_S = 0.005


class Watch:
    """Look until the state is so, sleeping in between."""

    def __init__(self, robot: Robot, what: Word | Callable[[State], bool], timeout_s: float | None) -> None:
        """Raises ValueError."""
        self._check, self._name = check(what)
        self._robot = robot
        self._timeout_s = timeout_s
        self._until_s = None if timeout_s is None else time.monotonic() + timeout_s

    def look(self) -> State | None:
        """The state, if it is so. Raises TimedOut, NoService."""
        state = None
        try:
            state = self._robot.state
        except NoService:
            if not self._robot.reconnects or self._late():
                raise
        except FailstopError:
            if self._robot.closed or self._late():
                raise
        if state and self._check(state):
            return state
        if self._timeout_s is not None and self._late():
            raise TimedOut(late(self._name, self._timeout_s, state))
        return None

    def _late(self) -> bool:
        return self._until_s is not None and time.monotonic() > self._until_s

    def sleep(self) -> None:
        """Until the next look is worth it."""
        time.sleep(LOOK_S)

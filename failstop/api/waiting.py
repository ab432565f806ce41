"""Waiting: what is waited for, as steps between which whoever waits sleeps - a thread here, a task in aio.py."""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Literal, TypeVar, get_args

from failstop.api import verdict
from failstop.api.news import News

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.api.client import Client
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


def limiting(share: float) -> Callable[[Client], None]:
    """What the gate finds with a request to limit the speed. Raises ValueError for a share that is no percentage of a
    speed."""
    if not 0.0 < share <= 1.0:
        raise ValueError(f"a speed limit of {share}: must be over 0, and at most 1")
    return lambda client: client.speed_limit(round(100 * share))


def check(what: Word | Callable[[State], bool]) -> Callable[[State], bool]:
    """What says whether a state is so. Raises ValueError for a word that there is not."""
    found = what if callable(what) else _CHECKS.get(what)
    if found is None:
        raise ValueError(f"wait_for({what!r}): no such word; there are {', '.join(_CHECKS)}")
    return found


def late(name: str, timeout_s: float, state: State | None) -> str:
    """What is told when it did not come about in time, with what to do."""
    if state is None:
        return f"waited {timeout_s:g} s for {name!r}: the service tells nothing; see `failstop doctor`"
    step = verdict.next_step(state)
    return f"waited {timeout_s:g} s for {name!r}: {verdict.headline(state)}" + (f"; next: {step}" if step else "")

"""Patience: for how long a guest may say nothing. While qemu waits for a processor of the host no time passes for it: a
busy host makes a guest slow, and a guest that is dead is silent on any host."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

MOST = 4.0
"""Times of the patience, by the clock: then a host is too busy for any guest."""
IDLE = 0.02
"""Of the patience: a guest that waits for something runs more than that, by its timers."""
Run = tuple[float, float]
"""(s of a processor that qemu had, s in which it waited for one)."""


def ran(pid: int) -> Run:
    """Of qemu's busiest thread, which runs the guest's processor, since its start; zeros once it has ended."""
    found = [(0, 0)]
    for task in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        try:
            ran_ns, waited_ns, _ = map(int, task.read_text().split())
        except (OSError, ValueError):
            continue  # it has just ended
        found.append((ran_ns, waited_ns))
    ran_ns, waited_ns = max(found)
    return ran_ns / 1e9, waited_ns / 1e9


class Patience:
    """From when it is made."""

    def __init__(self, wait_s: float, look: Callable[[], Run], now_s: Callable[[], float] = time.monotonic) -> None:
        """`wait_s`: of a time in which the host has a processor for the guest; `look`: what ran() says of qemu."""
        self._wait_s = wait_s
        self._look, self._now_s = look, now_s
        self._begun_s = now_s()
        self._begun = look()

    def _passed(self) -> tuple[float, float, float]:
        """(s by the clock, s that qemu had, s in which it waited)."""
        ran_s, held_s = self._look()
        return self._now_s() - self._begun_s, max(0.0, ran_s - self._begun[0]), max(0.0, held_s - self._begun[1])

    def left_s(self) -> float:
        """How long to wait before it is asked again; 0: it is over."""
        passed_s, _, held_s = self._passed()
        return max(0.0, min(self._wait_s - (passed_s - held_s), MOST * self._wait_s - passed_s))

    def why(self) -> str:
        """The meaning of the silence, once it is over."""
        passed_s, ran_s, held_s = self._passed()
        told = f"in {passed_s:.0f} s qemu ran for {ran_s:.0f} s and waited {held_s:.0f} s for a processor"
        if passed_s >= MOST * self._wait_s:
            return f"{told}: the host is too busy, so repeat on a quieter one"
        if ran_s < IDLE * self._wait_s:
            return f"{told}: the guest is dead, or sleeps"
        return f"{told}: the guest hangs, or is slower than the trial allows"

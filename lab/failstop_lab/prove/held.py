"""Held: when the machine did not run this process in time, which drives the robot and takes the times, or one of those
that it watches: the service's, a simulated board. A row that was taken meanwhile may be wrong by the machine's doing,
and says nothing of the robot."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType

from failstop.policy import causes
from failstop.policy.causes import Cause

EVERY_S = 0.01
WOKEN_LATE_NS = 50_000_000
"""Woken later than this, a process was held up: a quiet machine wakes it within a millisecond, and one that is busy and
has a core to spare within ten."""
OTHERS_S = 0.1
"""How often the kernel is asked for how long the others have waited for a processor."""
WAITED_SHARE = 0.2
"""The share of its time that the test may wait for a processor. The test sleeps for a millisecond at a time. On a quiet
machine it waits for a few percent of the time, with four programs per core for half of it."""
Mark = tuple[int, int]
"""A moment (ns), and for how long this process had waited for a processor until then (ns)."""
BUSY = (causes.STARVED, causes.HELD_UP)
"""The service's own word that the machine did not run it."""


def now() -> Mark:
    """The mark of this moment."""
    return time.monotonic_ns(), waited_ns()


def waited_ns(pid: int = 0) -> int:
    """For how long the main thread of a process has waited for a processor, by default of this one; 0 where the kernel
    does not count it, or there is no such process."""
    try:
        with open(f"/proc/{pid or 'self'}/schedstat", encoding="ascii") as file:
            return int(file.read().split()[1])
    except (OSError, ValueError, IndexError):
        return 0


class Held:
    """A context manager: within it a thread sleeps and notes how late it is woken, and how long others wait."""

    def __init__(self, mark: Callable[[], Mark] = now, others: Callable[[], Mapping[str, int]] = dict) -> None:
        """`mark`: the moment, and the waiting until then. `others`: processes that are watched too, by name; a pid of 0
        is none."""
        self.mark = mark
        self._others = others
        self._waits: dict[int, int] = {}
        self._late: list[tuple[int, int, str]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sleep, name="held", daemon=True)

    def __enter__(self) -> Held:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def end(self) -> None:
        """Note nothing more."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _sleep(self) -> None:
        due_ns = look_ns = time.monotonic_ns()
        while not self._ended.wait(EVERY_S):
            now_ns = time.monotonic_ns()
            self.woken(due_ns + round(EVERY_S * 1e9), now_ns)
            due_ns = now_ns
            if now_ns >= look_ns:
                look_ns = now_ns + round(OTHERS_S * 1e9)
                self.look(now_ns)

    def woken(self, due_ns: int, now_ns: int) -> None:
        """The thread runs again."""
        if now_ns - due_ns >= WOKEN_LATE_NS:
            self._late.append((now_ns, now_ns - due_ns, "this test"))

    def look(self, now_ns: int, waited: Callable[[int], int] = waited_ns) -> None:
        """Note which of the others has waited for too long since the last look. `waited`: how long a pid has in all."""
        before, self._waits = self._waits, {}
        for name, pid in tuple(self._others().items()):
            if pid <= 0:
                continue
            self._waits[pid] = all_ns = waited(pid)
            if pid in before and all_ns - before[pid] >= WOKEN_LATE_NS:
                self._late.append((now_ns, all_ns - before[pid], name))

    def longest(self, since_ns: int) -> tuple[int, str]:
        """How long at worst anybody was not run since then, and who; 0: never for WOKEN_LATE_NS."""
        return max(((late_ns, who) for at_ns, late_ns, who in self._late if at_ns >= since_ns), default=(0, ""))

    def starved(self, since: Mark, cause: Cause | None = None) -> str:
        """The sign that the machine starved the test, or one that it watches, since then; empty: there is none.
        `cause`: of the stop that is latched."""
        if cause and cause.kind in BUSY:
            return str(cause)
        late_ns, who = self.longest(since[0])
        if late_ns:
            return f"{who} was not run for {late_ns / 1e6:.0f} ms"
        now_ns, waited = self.mark()
        share = (waited - since[1]) / max(1, now_ns - since[0])
        return f"this test waited for a processor for {share:.0%} of the time" if share >= WAITED_SHARE else ""


def repeat(starved: str) -> str:
    """Advice where the machine starved the test."""
    return f"the machine was starved ({starved}): repeat on a quieter one"

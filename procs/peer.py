"""Peer: another process of the service, under watch from the moment the supervisor names it until it has died."""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.processes import BY_NAME
from failstop.procs.loop import READ
from failstop.shm import records
from failstop.shm.heartbeat import HeartbeatReader

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.procs.context import Context
    from failstop.procs.loop import Loop
    from failstop.shm.lifeline import Lifeline

_LINE = 1
"""In each process's block of futexes; line 0 is the supervisor's to wait on."""


class Peer:
    """`life` is None while there is none, or none whose death has not been answered."""

    __slots__ = ("_early", "_lifeline", "_loop", "_named", "_priority", "_stop", "_word", "death", "heart", "life")

    def __init__(self, name: str, context: Context, loop: Loop, stop: Callable[[], None]) -> None:
        """`stop`: what the thread does that the early news of its death comes to."""
        self.death = causes.DIED(name)
        """The cause of a stop for it."""
        self.heart = HeartbeatReader(context.segment(name))
        self.life: Lifeline | None = None
        self._word = context.segment("supervisor").word(f"{name}_life")
        self._lifeline = context.world.lifeline
        self._early = context.early
        self._stop = stop
        self._priority = BY_NAME[name].priority
        self._loop = loop
        self._named = 0

    def named(self) -> int:
        """The pid that the supervisor names; 0 before the first."""
        return records.unpack_life(self._word.get())[0]

    def follow(self) -> int:
        """Watch whom the supervisor names: by its pid at once, by its futex once it runs and so holds it. Returns the
        pid of the one before when its death had not been noticed, else 0."""
        named = self._word.get()
        pid, block = records.unpack_life(named)
        died = 0
        if named != self._named:
            self._named = named
            died = self.life.pid if self.life and self.life.dead() else 0
            self.drop()
            try:
                self.life = self._lifeline(pid)
            except ProcessLookupError:
                return died
            self._loop.watch(self.life.fd, READ)
        if self.life and not self.life.armed and self.heart.running(pid):
            self._early.arm(self.life, block, _LINE, lambda: self._stop_early(pid), self._priority)
        return died

    def _stop_early(self, pid: int) -> None:
        """In the thread that waits. Where another is named by now, somebody has stopped for this one: who was held up
        for so long must not cut into the motion that came after."""
        if self.named() == pid:
            self._stop()

    def died(self, ready: dict[int, int]) -> int:
        """Its pid when this wake-up, or the early news before it, says that it has died, else 0."""
        return self.life.pid if self.life and self.life.died(ready) else 0

    def drop(self) -> None:
        """Watch it no longer."""
        if self.life:
            self._loop.forget(self.life.fd)
            self.life.close()
            self.life = None

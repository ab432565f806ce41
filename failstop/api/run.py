"""Run: one run of a service as its clients see it - whether it still goes on, and what its settings declare."""

from __future__ import annotations

import contextlib
import select
import time
from typing import Any

import msgpack

from failstop.api.client import attach, run
from failstop.api.errors import FailstopError, Undeclared
from failstop.procs.gate.sources import PAD
from failstop.shm import layout
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import Lifeline, pid_namespace

LONGEST_SHOWN = 40


class Run:
    """The run that is there when this is made. Not for several threads at once."""

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError."""
        self._life: Lifeline | None = None
        self._poll: select.poll | None = None
        self.name = name
        self.found = run(name)
        """What its segments are named after, and whose they are."""
        self.supervisor = attach(name, layout.SUPERVISOR, self.found)
        self.incarnation = self.supervisor.incarnation
        self._beat = HeartbeatReader(self.supervisor)
        self._record = self.supervisor.latest_reader("rules")
        self._rules: dict[str, Any] = {}
        self._sources: frozenset[str] = frozenset()
        self._died = False

    def __del__(self) -> None:
        if self._life:
            with contextlib.suppress(OSError):  # whoever closes what is not theirs
                self._life.close()

    def _follow(self) -> dict[str, Any]:
        """What the supervisor says once, when it has begun; empty before that."""
        if not self._rules and (entry := self._record.read()):
            self._rules = msgpack.unpackb(entry[2])
            self._sources = frozenset(self._rules["sources"])
            self._watch()
        return self._rules

    def _watch(self) -> None:
        """Have the kernel tell of the supervisor's death, where its pid means the same process here as there."""
        own = pid_namespace()
        if not own or own != self._rules["pid_namespace"]:
            return
        try:
            self._life = Lifeline(self._beat.pid.get())
        except ProcessLookupError:
            self._died = True
        except OSError:
            return  # no descriptor is left, or this call is forbidden: then its silence tells
        else:
            self._poll = select.poll()
            self._poll.register(self._life.fd, select.POLLIN)

    def dead(self) -> bool:
        """True once the kernel says that the supervisor has died; False where it can't be asked."""
        if self._poll is None:
            self._follow()
        return bool(self._poll.poll(0)) if self._poll else self._died

    def silent(self, now_ns: int) -> bool:
        """True when the supervisor's lease has run out: then nothing admits motion."""
        rules = self._follow()
        return bool(rules) and self._beat.age_ns(now_ns) > rules["lease_ns"]

    def over(self) -> bool:
        """True when this run has ended. One system call at most while it goes on: cheap enough for every call."""
        if self._poll:
            return bool(self._poll.poll(0))
        return self.dead() or (self.silent(time.monotonic_ns()) and self._replaced())

    def _replaced(self) -> bool:
        """True when no service of this name, or another run of it, is there."""
        try:
            return run(self.name) != self.found
        except FailstopError:
            return True

    def check_source(self, source: str) -> None:
        """Raises Undeclared for a source that no client may command as; FailstopError while the service starts."""
        if source not in self._sources:
            self._check("source", (source,))

    def check_interlocks(self, interlocks: tuple[str, ...]) -> None:
        """Raises Undeclared for an interlock that the settings do not name; FailstopError while the service starts."""
        if interlocks:
            self._check("interlock", interlocks)

    def _check(self, kind: str, names: tuple[str, ...]) -> None:
        if not (rules := self._follow()):
            raise FailstopError(f"the service {self.name!r} is still starting: try again in a moment")
        declared: list[str] = rules[f"{kind}s"]
        known = ", ".join(declared) or "none"
        for name in (name[:LONGEST_SHOWN] for name in names if name not in declared):
            if (kind, name) == ("source", PAD):
                raise Undeclared(f"source {PAD!r} is the board's gamepad alone; a client's are {known}")
            nearest = _nearest(name, declared)
            raise Undeclared(
                f"no {kind} {name!r} in the settings of {self.name!r}, which declare: {known}; "
                + (f"did you mean {nearest!r}?" if nearest else f"add [{kind}s.NAME] and restart the service")
            )


def _nearest(name: str, declared: list[str]) -> str:
    """The declared name that may have been meant; empty when there is none."""
    try:
        from difflib import get_close_matches  # for a mistake only: it costs more than this file
    except ImportError:
        return ""  # a program that has given its rights up may be unable to read its own library
    return next(iter(get_close_matches(name, declared, 1)), "")

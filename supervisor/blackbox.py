"""The supervisor's part of the black box: its own ring, and starting the saver after a latched stop.

The saver (failstop/incidents/saver.py) is a process of its own, at ordinary priority, in its own session. Nothing here
waits for it but the end of the service, and that no longer than FINISH_S.
"""

from __future__ import annotations

import os

import msgpack

from failstop.shm import box, layout, records
from failstop.supervisor.starter import environment, script_command

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

    from failstop.supervisor.run import Run
    from failstop.supervisor.stops import Stop

SAMPLE_NS = 100_000_000
START_NS = 150_000_000
"""From a stop to the saver's start. Starting it holds the supervisor until the new process has a core, and that must
not come to the gate's lease: so before people have enabled motion again, when the repeats at 20 and 100 ms are out."""
COPY_NS = 2_200_000_000
"""From a stop to the copy: what can be known of a stop is known after 2.0 s (stops.py)."""
PATIENCE_NS = 60_000_000_000
"""A dead run's saver waits for the service to be ready, at most so long."""
MOST_SAVERS = 4
"""Stops that are being saved, or wait for it, at one time."""
FINISH_S = 1.0
NEXT = "next: look at the disk and at the state directory"


class Saver:
    """A saver that runs."""

    __slots__ = ("_hurry", "_result", "of_dead_run", "pid")

    def __init__(self, pid: int, hurry: int, result: int, *, of_dead_run: bool) -> None:
        """`hurry`: closed to have it copy now; `result`: what it has to say."""
        self.pid = pid
        self._hurry = hurry
        self._result = result
        self.of_dead_run = of_dead_run

    def hasten(self) -> None:
        """Have it copy now."""
        if self._hurry >= 0:
            os.close(self._hurry)
            self._hurry = -1

    def last_word(self) -> dict[str, Any] | None:
        """Of one that has ended: what it has saved, if anything, or what is `wrong`; None: it said nothing. Its
        descriptors are given back."""
        try:
            told = msgpack.unpackb(os.read(self._result, 4096))
        except (OSError, ValueError):
            told = None
        self.hasten()
        os.close(self._result)
        return told if isinstance(told, dict) else None


class BlackBox:
    """One turn: follow(). begin() once, when the other processes are started."""

    def __init__(self, run: Run) -> None:
        resources, settings = run.resources, run.settings
        self._now_ns, self._world = run.world.now_ns, run.world
        self._events = run.events
        self._readable = resources.readable
        self._on = settings.on("incidents.save")
        self._words = {
            "name": resources.name,
            "keep": str(int(settings["incidents.keep"])),
            "max_mb": str(int(settings["incidents.max_mb"])),
        }
        self._environment = environment(settings)
        self._ring = run.own.ring_writer("box")
        self._beats = [run.views[which].word("beat_ns") for which in layout.PROCESSES]
        self._ages_ns = [0] * len(self._beats)
        """The longest silence of each process since the last sample."""
        self._seen_ns = [0] * len(self._beats)
        """And when that was seen."""
        self._left = resources.left
        self._waiting: list[tuple[int, dict[str, str]]] = []
        """When to start a saver, and with what."""
        self._savers: list[Saver] = []
        self._sampled_ns = 0

    def wrote(self, now_ns: int) -> None:
        """The supervisor has written a burst itself."""
        self._ring.put(box.OWN_BURST_RECORD, now_ns)

    def latched(self, stop: Stop, epoch: int) -> None:
        """A stop is latched, the news is out: save what led to it, and what follows."""
        self._sample(self._now_ns())
        if self._on and len(self._waiting) + len(self._savers) < MOST_SAVERS:
            words = {"cause_ns": str(stop.t_ns), "epoch": str(epoch), "cause": stop.cause.pack().hex()}
            self._waiting.append((stop.t_ns + START_NS, words | {"until_ns": str(stop.t_ns + COPY_NS)}))

    def follow(self, now_ns: int, *, ready: bool) -> None:
        """Once a turn, at its end, and before the supervisor's own beat."""
        for index, beat in enumerate(self._beats):
            age_ns = now_ns - (beat.get() or now_ns)
            if age_ns >= self._ages_ns[index]:
                self._ages_ns[index], self._seen_ns[index] = age_ns, now_ns
        if now_ns - self._sampled_ns >= SAMPLE_NS:
            self._sample(now_ns)
        if self._savers:
            for saver in self._savers:
                if ready and saver.of_dead_run:
                    saver.hasten()
            self._reap()
        if self._waiting and now_ns >= self._waiting[0][0]:
            self._save_live()

    def _sample(self, now_ns: int) -> None:
        self._sampled_ns = now_ns
        silent_us = [age_ns // 1000 for age_ns in self._ages_ns]
        self._ring.put(box.pack_beats(silent_us, [(now_ns - seen_ns) // 1000 for seen_ns in self._seen_ns]), now_ns)
        self._ages_ns = [0] * len(self._beats)

    def begin(self) -> None:
        """Start the saver for a run before this one that was not ended in order. It copies nothing, and takes no
        processor time from anybody, before this run is ready: but by then nobody wants to be held up for its start."""
        left, self._left = self._left, {}
        try:
            if self._on and len(left) == len(layout.PROCESSES):
                self._start({"until_ns": str(self._now_ns() + PATIENCE_NS)}, left, of_dead_run=True)
        finally:
            self._close(left.values())

    def _save_live(self) -> None:
        _, words = self._waiting.pop(0)
        self._start(words, self._readable, of_dead_run=False)

    def _start(self, words: dict[str, str], fds: dict[str, int], *, of_dead_run: bool) -> None:
        """Start a saver. A machine that is out of descriptors or processes has none, and that is all."""
        pipes: list[int] = []
        try:
            pipes += os.pipe()
            pipes += os.pipe()
            hurry, hasten, told, result = pipes
            os.set_blocking(told, False)
            pid = self._spawn(words | {"hurry": str(hurry), "result": str(result)}, fds, (hurry, result))
        except OSError as error:
            self._close(pipes)
            self._not_saved(f"cannot start the saver: {error}; {NEXT}")
        else:
            self._close((hurry, result))
            self._savers.append(Saver(pid, hasten, told, of_dead_run=of_dead_run))

    def _spawn(self, words: dict[str, str], fds: dict[str, int], pipes: tuple[int, int]) -> int:
        words = self._words | words | {"fds": ",".join(f"{which}:{fd}" for which, fd in fds.items())}
        arguments = script_command(("incidents", "saver.py"), words=words)
        return self._world.spawn(arguments, self._environment, [*pipes, *fds.values()])

    def _reap(self) -> None:
        for saver in tuple(self._savers):
            if (code := self._world.reap(saver.pid)) is not None:
                self._savers.remove(saver)
                self._tell(code, saver.last_word())

    def _tell(self, code: int, told: dict[str, Any] | None) -> None:
        if not code and told == {}:
            return
        told = told or {}
        identity = "" if code else told.get("id")
        if identity:
            show = self._events.command(f"incident show {identity}")
            self._events.tell("incident", f"incident {identity} saved; next: {show}", told)
        else:
            died = f"the saver was killed by signal {-code}" if code < 0 else f"the saver ended with code {code}"
            self._not_saved(f"{records.printable(str(told.get('wrong', ''))) or died}; {NEXT}")

    def _not_saved(self, why: str) -> None:
        self._events.tell("incident", f"incident not saved: {why}", {"reason": why}, level="warning")

    @staticmethod
    def _close(fds: Iterable[int]) -> None:
        for fd in fds:
            os.close(fd)

    def finish(self) -> None:
        """The end of the service, its stops written: what is being saved is saved now."""
        while self._waiting:
            self._save_live()
        until_ns = self._now_ns() + round(FINISH_S * 1e9)
        for saver in self._savers:
            saver.hasten()
            try:
                life = self._world.lifeline(saver.pid)
            except OSError:
                continue
            life.wait(max(0, until_ns - self._now_ns()) * 1e-9)
            life.close()
        self._reap()
        self._events.flush()

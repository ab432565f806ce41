"""The supervisor's part of the black box: its own ring, and starting the saver after a latched stop.

The saver (failstop/incidents/saver.py) is a process of its own, at ordinary priority, in its own session. Nothing here
waits for it but the end of the service, and that no longer than FINISH_S.
"""

from __future__ import annotations

import os
import select
import sys
from time import monotonic_ns

from failstop.shm import box, layout, records, segment
from failstop.supervisor.starter import environment

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.segment import Segment
    from failstop.supervisor.causes import Cause
    from failstop.supervisor.events import Events
    from failstop.supervisor.resources import Resources
    from failstop.supervisor.settings import Settings

SAMPLE_NS = 100_000_000
START_NS = 150_000_000
"""From a stop to the saver's start. Starting it holds the supervisor until the new process has a core, and that must
not come to the gate's lease: so before people have enabled motion again, when the repeats at 20 and 100 ms are out."""
COPY_NS = 2_200_000_000
"""From a stop to the copy: what can be known of a stop is known after 2.0 s (stops.py)."""
PATIENCE_NS = 60_000_000_000
"""A dead run's saver waits for the service to be ready, at most so long."""
MOST_WAITING = 4
"""Stops whose saver is still to be started."""
FINISH_S = 1.0
NOTHING = "nothing to save"
"""The saver's word on a run that never was ready."""
NEXT = "next: look at the disk and at the state directory"


class BlackBox:
    """One turn: follow(). begin() once, when the other processes are started."""

    def __init__(
        self, resources: Resources, settings: Settings, own: Segment, views: dict[str, Segment], events: Events
    ) -> None:
        self._events = events
        self._name = resources.name
        self._on = settings.on("incidents.save")
        self._words = {
            "name": resources.name,
            "keep": str(int(settings["incidents.keep"])),
            "max_mb": str(int(settings["incidents.max_mb"])),
        }
        self._environment = environment(settings)
        self._ring = own.ring_writer("box")
        self._beats = [
            (own if which == layout.SUPERVISOR else views[which]).word("beat_ns") for which in layout.PROCESSES
        ]
        self._ages_ns = [0] * len(self._beats)
        """The longest silence of each process since the last sample."""
        self._seen_ns = [0] * len(self._beats)
        """And when that was seen."""
        self._left = resources.left
        self._waiting: list[tuple[int, dict[str, str]]] = []
        """When to start a saver, and with what."""
        self._pid = 0
        self._of_dead_run = False
        self._hurry = self._result = -1
        self._sampled_ns = 0

    def wrote(self, now_ns: int) -> None:
        """The supervisor has written a burst itself."""
        self._ring.put(box.OWN_BURST_RECORD, now_ns)

    def latched(self, cause: Cause, epoch: int) -> None:
        """A stop is latched, the news is out: save what led to it, and what follows."""
        self._sample(monotonic_ns())
        if self._on and len(self._waiting) < MOST_WAITING:
            words = {"cause_ns": str(cause.t_ns), "epoch": str(epoch), "reason": records.printable(cause.reason)}
            self._waiting.append((cause.t_ns + START_NS, words | {"until_ns": str(cause.t_ns + COPY_NS)}))

    def follow(self, now_ns: int, *, ready: bool) -> None:
        """Once a turn, at its end, and before the supervisor's own beat."""
        for index, beat in enumerate(self._beats):
            age_ns = now_ns - (beat.get() or now_ns)
            if age_ns >= self._ages_ns[index]:
                self._ages_ns[index], self._seen_ns[index] = age_ns, now_ns
        if now_ns - self._sampled_ns >= SAMPLE_NS:
            self._sample(now_ns)
        if self._pid:
            if ready and self._of_dead_run:
                self._hasten()
            self._reap()
        elif self._waiting and now_ns >= self._waiting[0][0]:
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
        if self._on and len(left) == len(layout.PROCESSES):
            self._of_dead_run = True
            self._start({"until_ns": str(monotonic_ns() + PATIENCE_NS)}, left)
        self._close(*left.values())

    def _save_live(self) -> None:
        _, words = self._waiting.pop(0)
        fds = segment.open_all(self._name)
        if len(fds) == len(layout.PROCESSES):
            self._start(words, fds)
        else:
            self._not_saved(f"shared memory is gone ({words['reason']}); next: restart the service")
        self._close(*fds.values())

    def _start(self, words: dict[str, str], fds: dict[str, int]) -> None:
        hurry, self._hurry = os.pipe()
        self._result, result = os.pipe()
        os.set_blocking(self._result, False)
        listed = ",".join(f"{which}:{fd}" for which, fd in fds.items())
        words = self._words | words | {"fds": listed, "hurry": str(hurry), "result": str(result)}
        script = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "incidents", "start.py")
        arguments = [sys.executable, "-I", "-S", script, *(f"{key}={value}" for key, value in words.items())]
        passed = [hurry, result, *fds.values()]
        for fd in passed:
            os.set_inheritable(fd, True)
        try:
            self._pid = os.posix_spawn(arguments[0], arguments, self._environment, setsid=True)
        except OSError as error:
            self._not_saved(f"cannot start the saver: {error}; {NEXT}")
            self._forget()
        finally:
            for fd in passed:
                os.set_inheritable(fd, False)
            self._close(hurry, result)

    def _reap(self) -> None:
        pid, status = os.waitpid(self._pid, os.WNOHANG)
        if not pid:
            return
        self._pid = 0
        try:
            told = os.read(self._result, 4096).decode("utf-8", "replace")
        except OSError:
            told = ""
        self._forget()
        code = os.waitstatus_to_exitcode(status)
        if not code and told == NOTHING:
            return
        if not code and told.startswith("saved "):
            identity = told.removeprefix("saved ")
            text = f"incident {identity} saved; next: `failstop incident show {identity}`"
            self._events.tell("incident", text, {"id": identity})
        else:
            died = f"the saver was killed by signal {-code}" if code < 0 else f"the saver ended with code {code}"
            self._not_saved(f"{records.printable(told) or died}; {NEXT}")

    def _hasten(self) -> None:
        """Have the saver copy now."""
        self._close(self._hurry)
        self._hurry = -1
        self._of_dead_run = False

    def _not_saved(self, why: str) -> None:
        self._events.tell("incident", f"incident not saved: {why}", {"reason": why}, level="warning")

    def _forget(self) -> None:
        self._close(self._hurry, self._result)
        self._hurry = self._result = -1

    @staticmethod
    def _close(*fds: int) -> None:
        for fd in fds:
            if fd >= 0:
                os.close(fd)

    def finish(self) -> None:
        """The end of the service, its stops written: a stop that is being saved is saved now."""
        until_ns = monotonic_ns() + round(FINISH_S * 1e9)
        while (self._pid or self._waiting) and (left_ns := until_ns - monotonic_ns()) > 0:
            if not self._pid:
                self._save_live()
                continue
            self._hasten()
            pidfd = os.pidfd_open(self._pid)
            select.select((pidfd,), (), (), left_ns * 1e-9)
            os.close(pidfd)
            self._reap()
        self._events.flush()

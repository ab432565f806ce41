"""The supervisor's part of the black box: it writes the supervisor's ring, and starts the saver after a latched stop.

The saver (failstop/incidents/saver.py) is a separate process at ordinary priority, in its own session. The supervisor
never waits for the saver, except at the end of the service, and then for at most FINISH_S.
"""

from __future__ import annotations

import _socket
import contextlib
import os
from collections.abc import Callable
from time import monotonic_ns, time_ns

import msgpack

from failstop.messages import box, layout, records
from failstop.messages.packing import NEXT_STEP
from failstop.shm.lifeline import Lifeline
from failstop.supervisor.run import Run
from failstop.supervisor.starter import environment, reap, script_command, spawn
from failstop.supervisor.stops import Stop

SAMPLE_NS = 100_000_000
START_NS = 150_000_000
"""How long after a stop the saver is started. Starting a process blocks the supervisor until the new process gets a
processor core. During that time the supervisor can't renew the lease for motion, so the saver starts before a person
can have reset the stop and enabled motion again. If the saver started at once, it could delay the repeats of the stop.
After START_NS, most boards have had all repeats."""
PATIENCE_NS = 60_000_000_000
"""If an earlier run has died, a saver waits until the current run is ready, and then saves what the earlier run has
left. This is the longest time that the saver waits."""
MOST_SAVERS = 4
"""How many savers may run at the same time."""
MOST_STOPS_WAITING = 16
"""How many stops may wait for a saver. More are very unlikely, because a person must reset each stop before another
stop can be latched."""
ON_TIME_NS = START_NS
"""If a saver could not be started within this time after its planned time (START_NS after the stop), it is started only
while the robot can't move. Its start could block the supervisor for so long that a moving robot stops."""
GIVE_UP_NS = 30_000_000_000
"""If a saver still can't be started this long after its planned time, the stop is not saved. The rings cover about a
minute. After this time, they hold less than half a minute from before the stop."""
FINISH_S = 4.0
"""How long the end of the service waits for all savers, in seconds. On a slow computer with an SD card, a saver may
need more than a second. systemd allows TimeoutStopSec for the whole end."""
STEP = "look at the disk and at the state directory"
OF_DEAD_RUN = {"run": "before"}
"""The field of an event about the incident of a dead, earlier run, as the saver reports it."""
TOO_OFTEN = "find out what stops and resets the robot so often"


class BlackBox:
    """The supervisor's part of the black box. Call begin() once, after the other processes have been started, and
    poll() once per turn."""

    def __init__(self, run: Run, moves: Callable[[], bool]) -> None:
        """`moves`: returns True while motion is enabled, and also while the newest frame on the port is motion."""
        self._run, self._moves = run, moves
        self._events = run.events
        self._on = run.settings.on("incidents.save")
        self._copy_ns = box.copy_ns(run.settings.ns("still.after_s"))
        keep, max_mb = int(run.settings["incidents.keep"]), int(run.settings["incidents.max_mb"])
        self._words = {"name": run.name, "keep": keep, "max_mb": max_mb}
        self._environment = environment(run.settings)
        self._ring = run.own.ring_writer("box")
        self._beats = [run.views[which].word("beat_ns") for which in layout.PROCESS_NAMES]
        self._silences = [(0, 0)] * len(self._beats)
        """For each process: (its longest silence since the last sample in ns, the time when that silence was seen)."""
        self._waiting: list[tuple[int, dict[str, object]]] = []
        """The savers that are not started yet, as (the time to start the saver, its options)."""
        self._savers: dict[int, _socket.socket] = {}
        """The socket to each running saver, by the saver's pid. When the supervisor shuts down its side of a socket,
        the saver stops waiting and copies the rings at once. The saver sends its report on the same socket."""
        self._for_dead_run = 0
        """The pid of the saver that will save what a dead, earlier run has left, as soon as the current run is ready. 0
        if no such saver waits."""
        self._dead_run_saver = 0
        """The pid of the saver for a dead, earlier run, also after it has ended. 0 if there was none."""
        self._sampled_ns = 0

    def wrote(self, now_ns: int) -> None:
        self._ring.put(box.OWN_BURST_RECORD, now_ns)

    def latched(self, stop: Stop, epoch: int) -> None:
        """Plan to save the moments before and after a stop. `stop`: the stop that was just latched and published."""
        self._sample(monotonic_ns())
        if self._on and len(self._waiting) >= MOST_STOPS_WAITING:
            self._not_saved(f"{MOST_STOPS_WAITING} earlier stops still wait to be saved", TOO_OFTEN)
        elif self._on:
            words = {"cause_ns": stop.t_ns, "epoch": epoch, "cause": stop.cause.pack().hex()}
            # Now, because the wall clock may jump before the copy, for example while the machine sleeps.
            words["offset_ns"] = time_ns() - monotonic_ns()
            self._waiting.append((stop.t_ns + START_NS, words | {"until_ns": stop.t_ns + self._copy_ns}))

    def poll(self, now_ns: int, *, ready: bool) -> None:
        """Sample the heartbeats, start the savers that are due and reap those that have ended. Call this at the end of
        each turn, but before the supervisor's own beat."""
        ages = ((now_ns - (beat.get() or now_ns), now_ns) for beat in self._beats)
        self._silences = list(map(max, self._silences, ages))
        if now_ns - self._sampled_ns >= SAMPLE_NS:
            self._sample(now_ns)
        if ready and self._for_dead_run:
            self._hasten(self._for_dead_run)
            self._for_dead_run = 0
        if self._savers:
            self._reap()
        if self._waiting and now_ns >= self._waiting[0][0]:
            self._start_next(now_ns)

    def _start_next(self, now_ns: int) -> None:
        """Start the next saver, unless MOST_SAVERS are running. If it is more than ON_TIME_NS late, it waits
        until the robot can't move. If it is more than GIVE_UP_NS late, it is given up."""
        late_ns = now_ns - self._waiting[0][0]
        if len(self._savers) < MOST_SAVERS and (late_ns <= ON_TIME_NS or not self._moves()):
            self._start(self._waiting.pop(0)[1], self._run.readable)
        elif late_ns > GIVE_UP_NS:
            self._waiting.pop(0)
            self._not_saved("too many stops at once, and then the robot drove again", TOO_OFTEN)

    def _sample(self, now_ns: int) -> None:
        self._sampled_ns = now_ns
        silent_us = [age_ns // 1000 for age_ns, _ in self._silences]
        self._ring.put(box.pack_beats(silent_us, [(now_ns - seen_ns) // 1000 for _, seen_ns in self._silences]), now_ns)
        self._silences = [(0, now_ns)] * len(self._beats)

    def begin(self) -> None:
        """Start a saver for an earlier run that did not end cleanly. The saver waits until the current run is ready, so
        that it does not slow down the start of the service. Do not start it later, because that could stop a robot that
        moves."""
        left = self._run.left
        if self._on and len(left) == len(layout.PROCESS_NAMES):
            self._dead_run_saver = self._start({"until_ns": monotonic_ns() + PATIENCE_NS}, left)
            self._for_dead_run = self._dead_run_saver
        while left:
            os.close(left.popitem()[1])

    def _start(self, words: dict[str, object], fds: dict[str, int]) -> int:
        """Start a saver and return its pid. `words`: its options. `fds`: the descriptors of the rings that it copies.
        Returns 0 if the machine has no descriptors or processes left."""
        ends: list[_socket.socket] = []
        try:
            ends += _socket.socketpair()
            ends[0].setblocking(False)
            theirs = ends[1].fileno()
            listed = ",".join(f"{which}:{fd}" for which, fd in fds.items())
            words = {**self._words, **words, "fds": listed, "hurry": theirs, "result": theirs}
            arguments = script_command(("incidents", "saver.py"), words=words)
            pid = spawn(arguments, self._environment, [theirs, *fds.values()])
            self._savers[pid] = ends.pop(0)
        except OSError as error:
            pid = 0
            self._not_saved(f"cannot start the saver: {error}", fields=OF_DEAD_RUN if "cause_ns" not in words else None)
        for end in ends:
            end.close()
        return pid

    def _hasten(self, pid: int) -> None:
        """Make the saver with the pid `pid` copy the rings now, if it is still running."""
        with contextlib.suppress(OSError, KeyError):
            self._savers[pid].shutdown(_socket.SHUT_WR)

    def _reap(self) -> None:
        for pid, saver in tuple(self._savers.items()):
            if (code := reap(pid)) is not None:
                try:
                    told = msgpack.unpackb(saver.recv(4096))
                except (OSError, ValueError):
                    told = None
                self._savers.pop(pid).close()
                self._log_saved(pid, code, told if isinstance(told, dict) else None)

    def _log_saved(self, pid: int, code: int, told: dict[str, str | float] | None) -> None:
        """Log what the saver `pid` has saved, or what went wrong. `code`: the saver's exit code. `told`: the saver's
        report, or None if it sent none."""
        if not code and told == {}:
            return
        told = told or {}
        identity = "" if code else told.get("id")
        if identity:
            show = self._events.command(f"incident show {identity}")
            self._events.log("incident", f"incident {identity} saved", told, step=show)
        else:
            died = f"the saver was killed by signal {-code}" if code < 0 else f"the saver ended with code {code}"
            ended = {"ended": records.printable(str(told["ended"]))} if "ended" in told else {}
            fields = {**OF_DEAD_RUN, **ended} if pid == self._dead_run_saver else None
            self._not_saved(f"{records.printable(str(told.get('wrong', ''))) or died}", fields=fields)

    def _not_saved(self, why: str, step: str = STEP, fields: dict[str, str] | None = None) -> None:
        found = {"reason": f"{why}{NEXT_STEP}{step}", **(fields or {})}
        self._events.log("incident", f"incident not saved: {why}", found, level="warning", step=step)

    def finish(self) -> None:
        """Start the savers that still wait, up to MOST_SAVERS, and then wait at most FINISH_S for all of them. Logs
        each that has not ended by then. Called at the end of the service, after the last burst."""
        while self._waiting and len(self._savers) < MOST_SAVERS:
            self._start(self._waiting.pop(0)[1], self._run.readable)
        for _ in self._waiting:
            self._not_saved("the service ended while earlier stops were being saved", TOO_OFTEN)
        self._waiting.clear()
        until_ns = monotonic_ns() + round(FINISH_S * 1e9)
        for pid in self._savers:
            self._hasten(pid)
        for pid in self._savers:
            try:
                life = Lifeline(pid)
            except OSError:
                continue
            life.wait(max(0, until_ns - monotonic_ns()) * 1e-9)
            life.close()
        self._reap()
        for pid in self._savers:  # systemd's stop tool kills them next; without systemd they may still finish
            fields = OF_DEAD_RUN if pid == self._dead_run_saver else None
            why = "the service ended while it was being written, so the file may be missing"
            self._not_saved(why, fields=fields)
        self._events.flush()

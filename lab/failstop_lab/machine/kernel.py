"""Kernel: the clock, the schedule, deaths and signals of a simulated machine.

One thread of a process runs at a time, until a call of the simulated system blocks. Nothing here reads the real clock,
so that two runs of one seed are equal to the byte. Time passes in two ways: each call takes step_ns, and when every
thread waits, the clock jumps to the next timer. A test may take part inline: its calls are those of a process of the
machine, and while one of them blocks, the machine runs.
"""

from __future__ import annotations

import contextlib
import errno
import heapq
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any

from greenlet import getcurrent

from failstop_lab.machine import collector
from failstop_lab.machine.files import Directory
from failstop_lab.machine.process import Death, Process, Thread

STEP_NS = 2_000
"""How long a system call takes."""
SPAWN_NS = 40_000_000
CLOCK_READ_NS = 50
"""How long it takes to read the clock."""
TAKEDOWN_NS = 400_000
"""How long after a death the late news of it comes, because the kernel frees the memory first
(docs/dev/architecture.md, Choices)."""
SIGHUP, SIGINT, SIGKILL, SIGTERM, SIGCHLD, SIGCONT, SIGSTOP, SIGTSTP = 1, 2, 9, 15, 17, 18, 19, 20
IGNORED = (SIGCHLD, SIGCONT)
"""Signals that do nothing by default."""
LAND_NS = 100_000
"""From a kill to the end of a write that the victim was in: it is done, and then the process dies."""
FIRST_PID = 100
FOREVER_NS = 1 << 61
running_machines: weakref.WeakSet[Machine] = weakref.WeakSet()
"""The machines that have not ended."""


class Machine:
    """The machine. `at_seam` is asked before each call of the system, with the thread and the call's name; what it
    raises is what the call raises. Its threads keep it in memory until end()."""

    def __init__(self, seed: int = 0, step_ns: int = STEP_NS, look_ns: int = CLOCK_READ_NS) -> None:
        """`step_ns`, `look_ns`: the time that a call of the system and a look at the clock take, in ns. With 0 time
        passes by the timers alone, a loop that only looks at the clock never ends, and a program starts at once."""
        self.now_ns = 1_000_000_000_000
        self.step_ns, self.look_ns = step_ns, look_ns
        self.start_ns = SPAWN_NS if step_ns else 0
        """From a spawn to the first line of the program: an interpreter starts."""
        self.slept_ns = 0
        self.sleep_looks = self.starved_looks = self.switches = 0
        """How often a clock was read that goes on in a sleep, a held process was asked for why, a thread went on."""
        self.unix_ns = 1_700_000_000_000_000_000
        """The time of day when the clock stood at zero."""
        self.seed = seed
        self.root = Directory()
        self.processes: dict[int, Process] = {}
        self.at_seam: Callable[[Thread, str, tuple[Any, ...]], None] | None = None
        self.current: Thread | None = None
        self.programs: dict[str, Callable[[Process, list[str]], int]] = {}
        """The programs that there are, by the last part of a script's path; any other one ends at once."""
        self.refused = 0
        """Rights that it grants to nobody, as bits of the heartbeat."""
        self.shortened = False
        """The next write takes a half of what it is given."""
        self.on_event: Callable[[str, Process, object], None] = lambda kind, process, what: None
        """Told of each start and death."""
        self.hub = getcurrent()
        self.inline: Thread | None = None
        """The thread that runs inline, in the hub itself."""
        self.runnable: deque[Thread] = deque()
        self._timers: list[tuple[int, int, Callable[[], None]]] = []
        self._order = 0
        self._next_pid = FIRST_PID
        self._threads = 0
        running_machines.add(self)

    def end(self) -> None:
        """End every thread, and forget all that is on the machine: each later call of a process is a Death."""
        running_machines.discard(self)
        processes, self.processes = self.processes, {}
        self.current = self.inline = self.at_seam = None
        self.on_event = lambda kind, process, what: None
        for process in processes.values():
            process.dead = True
        for thread in [thread for process in processes.values() for thread in process.threads]:
            if thread.greenlet is not self.hub:
                thread.greenlet.parent = getcurrent()
                thread.greenlet.throw(Death)
        self.root = Directory()
        self.programs.clear()
        self.runnable.clear()
        self._timers.clear()

    def finalizer(self, body: Callable[..., object]) -> Callable[..., None]:
        """A finalizer as this machine runs it: not for the collector, which comes in the middle of any process."""

        def run(*arguments: Any, **named: Any) -> None:
            if not collector.at_work():
                with contextlib.suppress(Death):
                    body(*arguments, **named)

        return run

    # Time.

    def at(self, t_ns: int, what: Callable[[], None]) -> None:
        """Have something done at that time, by the machine itself."""
        self._order += 1
        heapq.heappush(self._timers, (t_ns, self._order, what))

    def run(self, until: Callable[[], bool], limit_ns: int) -> bool:
        """Let the machine run until something is so; False: it was not within `limit_ns` from now."""
        end_ns = self.now_ns + limit_ns
        while not until():
            if self.now_ns > end_ns:
                return False
            if self._timers and self._timers[0][0] <= self.now_ns:
                heapq.heappop(self._timers)[2]()
            elif self.runnable:
                self._switch(self.runnable.popleft())
            elif self._timers:
                if self._timers[0][0] > end_ns:
                    self.now_ns = end_ns
                    return until()
                self.now_ns = max(self.now_ns, self._timers[0][0])
            else:
                self.now_ns = end_ns
                return until()
        return True

    def _switch(self, thread: Thread) -> None:
        process = thread.process
        if process.dead:
            return
        if process.held_until_ns > self.now_ns:
            process.parked.append(thread)
            return
        if thread is self.inline:
            thread.ready = True
            return
        self.current = thread
        self.switches += 1
        thread.greenlet.switch()
        self.current = self.inline

    def _leave(self, thread: Thread) -> None:
        """Let others run until this thread's turn has come. Raises RuntimeError for one inline that waits for ever."""
        if thread is not self.inline:
            self.hub.switch()
            return
        thread.ready = False
        self.current = None
        try:
            if not self.run(lambda: thread.ready, FOREVER_NS):
                raise RuntimeError("a call that blocks is never answered: nothing on the machine would wake it")
        finally:
            self.current = thread

    def join(self, name: str, environ: dict[str, str] | None = None) -> Process:
        """A process whose main thread is the caller: its calls are made inline; while they block, the machine runs."""
        made = Process(self, self._new_pid(), None, name, environ or {})
        self.current = self.inline = Thread(made, lambda: None, made.pid, self.hub)
        made.threads.append(self.inline)
        return made

    # Threads.

    def thread(self, process: Process, body: Callable[[], object]) -> Thread:
        """Start a thread of a process."""
        self._threads += 1
        thread = Thread(process, body, self._threads)
        process.threads.append(thread)
        self.runnable.append(thread)
        return thread

    def finish(self, thread: Thread, body: Callable[[], object]) -> None:
        """A thread's whole life: its body, and what its end means. The end of the main thread is its process's."""
        process = thread.process
        code: object = 0
        try:
            code = body()
        except Death:
            return
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except Exception as error:
            self.on_event("failed", process, error)
            code = 1
        if process.dead:
            return
        self.mark(thread)
        if thread.number == process.pid:
            self.die(process, code if isinstance(code, int) else 0)
        process.threads.remove(thread)

    def mark(self, thread: Thread) -> None:
        """The kernel tells of a thread's death on every futex that it held."""
        for futex in thread.robust:
            futex.owner_died(thread.number)
        thread.robust = []

    def caller(self) -> Thread:
        """The thread that makes a call. Raises Death where none of a living process does."""
        thread = self.current
        try:
            if thread and not thread.process.dead and not collector.at_work() and getcurrent() is thread.greenlet:
                return thread
        except RuntimeError:  # of a greenlet that is being collected itself
            pass
        raise Death

    def block(self, until_ns: int | None = None) -> bool:
        """Wait in the current thread until wake(), or that time; True when it was woken. Handles signals meanwhile."""
        thread = self.caller()
        while True:
            self._wait(thread, until_ns)
            if thread.process.dead:
                raise Death
            if thread.process.pending and thread is thread.process.threads[0]:
                self.handle_signals(thread.process)
            if thread.woken or (until_ns is not None and self.now_ns >= until_ns):
                return thread.woken

    def _wait(self, thread: Thread, until_ns: int | None) -> None:
        thread.token += 1
        thread.waiting, thread.woken = True, False
        if until_ns is not None:
            token = thread.token
            self.at(until_ns, lambda: self._timed_out(thread, token))
        self._leave(thread)

    def _timed_out(self, thread: Thread, token: int) -> None:
        if thread.waiting and thread.token == token:
            thread.waiting = False
            self.runnable.append(thread)

    def wake(self, thread: Thread, *, for_signal: bool = False) -> None:
        """Let a thread that waits look again."""
        if thread.waiting:
            thread.waiting = False
            thread.woken = not for_signal
            self.runnable.append(thread)

    def give_way(self, to: Process | None = None) -> None:
        """Let every other runnable thread run first, or those of one process alone."""
        thread = self.caller()
        first = [each for each in self.runnable if to is None or each.process is to]
        self.runnable = deque((*first, thread, *(each for each in self.runnable if each not in first)))
        self._leave(thread)
        if thread.process.dead:
            raise Death

    # Processes.

    def process(
        self,
        name: str,
        body: Callable[[Process], object],
        environ: dict[str, str] | None = None,
        parent: Process | None = None,
        after_ns: int = 0,
    ) -> Process:
        """Start a process; its first line runs after so long."""
        made = Process(self, self._new_pid(), parent, name, environ or {})
        thread = Thread(made, lambda: body(made), made.pid)
        made.threads.append(thread)
        if after_ns:
            self.at(self.now_ns + after_ns, lambda: self.runnable.append(thread))
        else:
            self.runnable.append(thread)
        self.on_event("started", made, name)
        return made

    def _new_pid(self) -> int:
        pid, self._next_pid = self._next_pid, self._next_pid + 1
        self._threads = max(self._threads, pid)
        return pid

    def die(self, process: Process, code: int) -> None:
        """A process dies at once: nothing of it runs any more. Its futexes tell of it now, the rest later."""
        if process.dead:
            return
        if process.in_write:
            self.at(self.now_ns + LAND_NS, lambda: self._landed(process, code))
            return
        process.dead = True
        self.on_event("died", process, code)
        for thread in process.threads:
            self.mark(thread)
        self.at(self.now_ns + TAKEDOWN_NS, lambda: self._take_down(process, code))
        if self.current is not None and self.current.process is process:
            self.hub.switch()
            raise Death

    def _landed(self, process: Process, code: int) -> None:
        if lands := process.in_write:
            process.in_write = None
            lands()
            self.die(process, code)

    def _take_down(self, process: Process, code: int) -> None:
        for fd in list(process.files):
            process.close(fd)
        process.code = code
        for each in self.processes.values():
            if each.parent is process:
                if each.dies_with_parent:
                    self.kill(each, SIGKILL)
                each.parent = None
        for pidfd in process.watchers:
            pidfd.notify()
        if process.parent:
            self.kill(process.parent, SIGCHLD)

    def threads(self) -> dict[int, Thread]:
        """All threads of all living processes, by number."""
        living = [each for each in self.processes.values() if not each.dead]
        return {thread.number: thread for process in living for thread in process.threads}

    def living(self, pid: int) -> Process:
        """The process with this number, until it is reaped. Raises ProcessLookupError."""
        found = self.processes.get(pid)
        if found is None or found.reaped:
            raise ProcessLookupError(errno.ESRCH, "no such process")
        return found

    def addressed(self, pid: int) -> list[Process]:
        """The process with this number; below 0: the whole group. Raises ProcessLookupError."""
        if pid > 0:
            return [self.living(pid)]
        group = [each for each in self.processes.values() if each.group == -pid and not each.reaped]
        if not group:
            raise ProcessLookupError(errno.ESRCH, "no such process group")
        return group

    def kill(self, process: Process, number: int) -> None:
        """Send a signal."""
        if process.dead:
            return
        handler = process.handlers.get(number)
        if number == SIGSTOP or (number == SIGTSTP and handler is None):
            self.hold(process, FOREVER_NS)
        elif number == SIGCONT:
            process.continued = True
            self.resume(process)
        elif number != SIGKILL and callable(handler):
            process.pending.append(number)
            if process.threads:
                self.wake(process.threads[0], for_signal=True)
        elif number == SIGKILL or (handler is None and number not in IGNORED):
            self.die(process, -number)

    def handle_signals(self, process: Process) -> None:
        while process.pending:
            number = process.pending.popleft()
            handler = process.handlers.get(number)
            if callable(handler):
                handler(number, None)

    def hold(self, process: Process, ns: int, *, starved: bool = False) -> None:
        """Run nothing of a process for so long."""
        if process.held_until_ns <= self.now_ns:
            process.held_since_ns = self.now_ns
        process.held_until_ns = max(process.held_until_ns, self.now_ns + ns)
        process.starved = starved

        def over() -> None:
            if self.now_ns >= process.held_until_ns:
                self.resume(process)

        if ns < FOREVER_NS:
            self.at(process.held_until_ns, over)
        if self.current is not None and self.current.process is process:
            process.parked.append(self.current)
            self.hub.switch()
            if process.dead:
                raise Death

    def resume(self, process: Process) -> None:
        process.held_until_ns, process.resumed_ns = 0, self.now_ns
        process.starved = False
        self.runnable.extend(process.parked)
        process.parked = []

    def call(self, name: str, *about: Any) -> Process:
        """Begin a call of the system: returns the process that makes it."""
        thread = self.caller()
        process = thread.process
        self.now_ns += self.step_ns
        if process.pending and thread is process.threads[0]:
            self.handle_signals(process)
        if self.at_seam is not None:
            self.at_seam(thread, name, about)
        return process

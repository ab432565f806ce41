"""Family: the supervisor's children - starting them, naming them to those who watch them, burying and restarting."""

from __future__ import annotations

import os
import signal
from time import monotonic_ns

from failstop.procs.loop import READ
from failstop.shm import layout, records
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import EarlyNews
from failstop.shm.mutex import BLOCKS
from failstop.supervisor.children import Child
from failstop.supervisor.restarts import Restarts
from failstop.supervisor.starter import Starter
from failstop.supervisor.table import PROCESSES

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.loop import Loop
    from failstop.shm.mutex import Mutexes
    from failstop.shm.segment import Segment
    from failstop.supervisor.events import Events
    from failstop.supervisor.resources import Resources
    from failstop.supervisor.settings import Settings

TRY_AGAIN_NS = 500_000_000


class Family:
    """Every process of the table as it is now. The early news of their deaths ring `early.bell`."""

    def __init__(
        self,
        resources: Resources,
        settings: Settings,
        loop: Loop,
        own: Segment,
        views: dict[str, Segment],
        mutexes: Mutexes,
        events: Events,
    ) -> None:
        """Holds the supervisor's own mutexes from here on."""
        self._resources = resources
        self._events = events
        self._loop = loop
        self._bells = resources.bells
        self._life_words = {process: own.word(f"{process}_life") for process in (layout.GATE, layout.PORT_OWNER)}
        self._mutexes = mutexes
        mutexes.prepare(layout.SUPERVISOR_BLOCK)
        mutexes.hold(layout.SUPERVISOR_BLOCK)
        self._block = layout.SUPERVISOR_BLOCK
        self.early = EarlyNews(mutexes)
        self._starter = Starter(resources.name, resources.incarnation, resources.runtime_dir, settings)
        deaths, window_ns = int(settings["restart.deaths"]), settings.ns("restart.window_s")
        backoff_ns = settings.ns("restart.backoff_s")
        self.children = [
            Child(row, HeartbeatReader(views[row.name]), Restarts(deaths, window_ns, backoff_ns)) for row in PROCESSES
        ]
        self._by_name = {child.row.name: child for child in self.children}

    def __getitem__(self, name: str) -> Child:
        return self._by_name[name]

    def fallen(self, ready: dict[int, int]) -> list[Child]:
        """Those whose death this wake-up, or the early news before it, tells; each once."""
        return [child for child in self.children if child.life and not child.fallen and child.life.down(ready)]

    def bury(self, ready: dict[int, int], now_ns: int) -> None:
        """Collect the processes that have died, and plan their restarts."""
        for child in self.children:
            if child.life and child.life.fd in ready:
                child.ended = True
                self._loop.forget(child.life.fd)  # it stays readable, however long it takes to be collected
            pid = child.pid
            if child.ended and (death := child.buried()):
                self._bury(child, pid, death, now_ns)

    def _bury(self, child: Child, pid: int, death: str, now_ns: int) -> None:
        name = child.row.name
        told: dict[str, str | int] = {"process": name, "pid": pid}
        if child.fence:
            self._events.tell("fenced", child.fence.story(name), {**told, **child.fence.fields()})
        how = f"was {death}" if death.startswith("killed") else death
        self._events.tell("died", f"{name} (pid {pid}) {how}", {**told, "how": how})
        wait_ns = child.restarts.died(now_ns)
        if wait_ns is None:
            text = f"{name} died too often and stays down, the wheels stopped; next: restart the service"
            self._events.tell("down", text, {"process": name})
        else:
            child.restart_ns = now_ns + wait_ns
            text = f"restarting {name} {f'in {wait_ns / 1e9:g} s' if wait_ns else 'now'}"
            self._events.tell("restarting", text, {"process": name, "wait_s": wait_ns / 1e9})

    def arm(self) -> None:
        """A process that runs holds its mutexes: wait for the early news of its death."""
        for child in self.children:
            if child.life and not child.life.armed and child.running():
                self.early.arm(child.life, child.block, 0)
                self._tell_watchers()

    def _tell_watchers(self) -> None:
        """Those who watch others look up whom, and who runs."""
        self._bells[layout.PORT_OWNER].ring()
        self._bells[layout.STOPPER].ring()

    def restart_due(self, port_fd: int, now_ns: int) -> None:
        """Start those whose time has come; `port_fd`: the port to inherit, -1 for none."""
        for child in self.children:
            if child.restart_ns is not None and now_ns >= child.restart_ns:
                child.times_restarted += 1
                self.start(child, port_fd)

    def start(self, child: Child, port_fd: int) -> None:
        """Start a process and name it to those who watch it."""
        name = child.row.name
        descriptors = self._resources.descriptors(name, port_fd)
        block = self._free_block()
        self._mutexes.prepare(block)
        try:
            pid = self._spawn(child, block, descriptors)
        except OSError as error:
            text = f"cannot start {name}: {error}; trying again"
            self._events.tell("start_failed", text, {"process": name, "reason": str(error)})
            child.restart_ns = monotonic_ns() + TRY_AGAIN_NS
            return
        if child.life:
            self._loop.watch(child.life.fd, READ)
        if word := self._life_words.get(name):
            word.set(records.life(pid, block))
            self._tell_watchers()

    def _spawn(self, child: Child, block: int, descriptors: dict[str, int]) -> int:
        """Start a process and take it under watch; returns its pid. Raises OSError, and then there is none."""
        pid = self._starter.start(child.row, block, descriptors)
        try:
            child.started(pid, block, monotonic_ns())
        except OSError:
            # Out of descriptors: without its pidfd nobody would know of its death.
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise
        return pid

    def _free_block(self) -> int:
        """The next block of mutexes that no living process holds."""
        held = {child.block for child in self.children if child.pid} | {layout.SUPERVISOR_BLOCK}
        self._block = next(b for i in range(1, BLOCKS) if (b := (self._block + i) % BLOCKS) not in held)
        return self._block

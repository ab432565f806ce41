"""Context: what a process gets from the supervisor when it is started, and the first steps that every process takes.

The values are passed on the command line, where `ps` shows them. Only the settings are passed in an environment
variable. For example:

    bootstrap.py gate name=failstop run=8f3a... dir=/run/failstop/failstop parent=812 block=3 number=1 bell=5 ...
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import monotonic_ns

from failstop.board.kinds import board_of
from failstop.messages import layout, segments
from failstop.policy.settings import SETTINGS_VARIABLE, Settings
from failstop.procs import rights
from failstop.procs.loop import Loop
from failstop.shm.bell import EventBell
from failstop.shm.futex import PER_BLOCK
from failstop.shm.heartbeat import BEAT_RUNNING, BEAT_STOPPING, Heartbeat
from failstop.shm.lifeline import EarlyNews
from failstop.shm.segment import Segment


class Context:
    """What a started process has: its segment, its heartbeat, its settings, and the descriptors that it inherited."""

    def __init__(self, process: str, words: dict[str, str], priority: int, *, outlives_parent: bool) -> None:
        self.instance = words.pop("name")
        self.incarnation = int(words.pop("run"), 16)
        self.memory = segments.memory(self.instance, self.incarnation)
        self.runtime_dir = words.pop("dir")
        self.parent = int(words.pop("parent"))
        block = int(words.pop("block"))
        self.port_number = int(words.pop("number"))
        self._fds = {key: int(value) for key, value in words.items()}
        for fd in self._fds.values():
            if fd >= 0:
                os.set_inheritable(fd, False)
        rights.name_process(f"fs:{process}")
        if not outlives_parent:
            rights.die_with_parent(self.parent)
        granted = rights.request_rights(priority)
        self.settings = Settings.from_lines(os.environ.get(SETTINGS_VARIABLE, ""))
        self.board = board_of(*self.settings.board(), tried=True)
        self.own = segments.attach(self.memory, process, self.incarnation, write=True)
        lifelines = segments.attach(self.memory, "lifelines", self.incarnation, write=True)
        self.held = lifelines.futex("held", block * PER_BLOCK, write=True).hold(PER_BLOCK)
        self.early = EarlyNews(lifelines)
        self.heartbeat = Heartbeat(self.own, os.getpid(), granted, monotonic_ns())

    def run(self, turn: Callable[[dict[int, int]], bool | None], loop: Loop, longest_ns: int) -> None:
        """End the start-up (rights.settle), and report to the supervisor that the process runs. Then call `turn` once
        per wake-up with the ready descriptors, until it returns False. `longest_ns`: the longest sleep between two
        calls."""
        rights.settle()
        self.heartbeat.state(BEAT_RUNNING, monotonic_ns())
        self.bell("supervisor_bell").ring()
        ready: dict[int, int] = {}
        while turn(ready) is not False:
            ready = loop.wait(longest_ns)
        self.heartbeat.state(BEAT_STOPPING, monotonic_ns())

    def fd(self, key: str) -> int:
        """Return the inherited descriptor with this name on the command line, or -1 if it is not open, for example
        while the port is gone."""
        return self._fds[key]

    def bell(self, key: str) -> EventBell:
        return EventBell(self._fds[key])

    def segment(self, name: str) -> Segment:
        return segments.attach(self.memory, name, self.incarnation)

    def client_slots(self) -> list[Segment]:
        """Return the segments of all clients. They are read through their descriptors, not mapped into memory. A
        segment whose file was removed counts as unused."""
        return [segments.read_client_slot(self.memory, at, self.incarnation) for at in range(layout.CLIENT_SLOTS)]

"""Resources: what a run of the service makes before its first process starts, and takes away at its end."""

from __future__ import annotations

import grp
import os

from failstop.procs import handover
from failstop.shm import bell, claim, instance, layout, segment
from failstop.shm.bell import EventBell

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.shm.segment import Segment

GROUP = "failstop"
"""Whoever is in this group may drive; everyone may stop."""
SHARED_MEMORY = "shared memory "


def client_gid() -> int:
    """The group whose members may drive; -1 (the service's own) where it does not exist."""
    try:
        return grp.getgrnam(GROUP).gr_gid
    except KeyError:
        return -1


class Resources:
    """Shared memory, pipes, claims, bells and control sockets of one run."""

    def __init__(self, name: str, runtime_dir: str) -> None:
        """The caller holds the instance's lock: whatever is found there is a dead run's. Raises segment.AttachError,
        instance.InstanceError, OSError, and leaves what it found then, and nothing else."""
        self.name = name
        self.runtime_dir = runtime_dir
        self.incarnation = int.from_bytes(os.urandom(8), "little")
        gid = client_gid()
        may_change_group = gid >= 0 and (os.geteuid() == 0 or gid in os.getgroups())
        gid = gid if may_change_group else -1
        self.memory = segment.memory(name, self.incarnation)
        """What the segments are named after."""
        self._refuse_living()
        dead = segment.dead_runs(name)
        self.left = segment.open_all(dead[-1]) if dead else {}
        """The segments of a run that was not ended in order: its black box. They go when this run has its own."""
        self._segments: list[Segment] = []
        self.readable: dict[str, int] = {}
        """Of the processes' segments, for the black box: they can be copied whatever becomes of their names."""
        try:
            self._make(gid)
        except BaseException:
            self.remove()
            raise
        for run in dead:
            segment.unlink_all(run)

    def _refuse_living(self) -> None:
        """Whatever became of the lock's file: what a living run has is not taken from it."""
        try:
            incarnation, _ = instance.run(self.runtime_dir)
        except instance.NoService:
            return
        if segment.living(segment.memory(self.name, incarnation)):
            raise instance.already_running(self.name, "unknown")

    def _make(self, gid: int) -> None:
        # One after the other: what is there is known, whichever can't be made.
        for spec in layout.SEGMENTS:
            self._segments.append(segment.create(self.memory, spec.name, self.incarnation, gid))
        self.readable = segment.open_all(self.memory)
        if missing := [process for process in layout.PROCESSES if process not in self.readable]:
            raise segment.AttachError("absent", f"shared memory {missing[0]} was there and can't be opened: try again")
        self.published = instance.publish(self.runtime_dir, self.incarnation)
        # For writing alone: whoever could read them could take away the requests of others.
        bell.make_pipe(instance.stop_path(self.runtime_dir), 0o622)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o620, gid)
        os.close(claim.open_claims(instance.claims_path(self.runtime_dir), create=True, mode=0o660, gid=gid))
        self.stop_pipe = bell.open_pipe(instance.stop_path(self.runtime_dir))
        self.client_bell = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self.named = {f"{SHARED_MEMORY}{made.spec.name}": made.fileno() for made in self._segments}
        """A descriptor of whatever others find by its name."""
        self.named |= {
            "the stop pipe": self.stop_pipe,
            "the bell of the clients": self.client_bell,
            "the name of the run": self.published,
        }
        self.bells = {process: EventBell.create() for process in layout.PROCESSES}
        self.controls = {process: handover.pair() for process in (layout.PORT_OWNER, layout.STOPPER)}

    def descriptors(self, process: str, port_fd: int) -> dict[str, int]:
        """Every descriptor that a process of the table may be given, by the name it has there."""
        found = {f"{other}_bell": found.fd for other, found in self.bells.items()}
        found |= {"bell": self.bells[process].fd, "port": port_fd}
        found |= {"stop": self.stop_pipe, "client_bell": self.client_bell}
        if process in self.controls:
            found["control"] = self.controls[process][1]
        return found

    def remove(self) -> None:
        """Take away every name; descriptors and mappings end with their processes."""
        for made in self._segments:
            made.close()
        while self.readable:
            os.close(self.readable.popitem()[1])
        segment.unlink_all(self.memory)
        instance.clear(self.runtime_dir)

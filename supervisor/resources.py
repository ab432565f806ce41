"""Resources: what a run of the service makes before its first process starts, and takes away at its end."""

from __future__ import annotations

import contextlib
import grp
import os

from failstop.procs import handover
from failstop.shm import bell, claim, instance, layout, segment
from failstop.shm.bell import EventBell

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
        """The caller holds the instance's lock: whatever is found there is a dead run's. Raises segment.AttachError."""
        self.name = name
        self.runtime_dir = runtime_dir
        self.incarnation = int.from_bytes(os.urandom(8), "little")
        gid = client_gid()
        may_change_group = gid >= 0 and (os.geteuid() == 0 or gid in os.getgroups())
        gid = gid if may_change_group else -1
        self.left = segment.open_all(name)
        """The segments of a run that was not ended in order, which are unlinked now: its black box."""
        self._segments = [segment.create(name, spec.name, self.incarnation, gid) for spec in layout.SEGMENTS]
        self.readable = segment.open_all(name)
        """Of the processes' segments, for the black box: they can be copied whatever becomes of their names."""
        if missing := [process for process in layout.PROCESSES if process not in self.readable]:
            raise segment.AttachError("absent", f"shared memory {missing[0]} was there and can't be opened: try again")
        # For writing alone: whoever could read them could take away the requests of others.
        bell.make_pipe(instance.stop_path(runtime_dir), 0o622)
        bell.make_pipe(instance.bell_path(runtime_dir), 0o620, gid)
        os.close(claim.open_claims(instance.claims_path(runtime_dir), create=True, mode=0o660, gid=gid))
        self.stop_pipe = bell.open_pipe(instance.stop_path(runtime_dir))
        self.client_bell = bell.open_pipe(instance.bell_path(runtime_dir))
        self.named = {f"{SHARED_MEMORY}{made.spec.name}": made.fileno() for made in self._segments}
        """A descriptor of whatever others find by its name."""
        self.named |= {"the stop pipe": self.stop_pipe, "the bell of the clients": self.client_bell}
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
        segment.unlink_all(self.name)
        for path in (instance.stop_path, instance.bell_path, instance.claims_path):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(path(self.runtime_dir))

"""What dead runs left in shared memory: finding it, and removing it without touching what lives."""

from __future__ import annotations

import contextlib
import dataclasses
import os

from failstop.doctor.system import SHM, System, User, user
from failstop.shm import claim, instance, segment
from failstop.shm.instance import InstanceError


@dataclasses.dataclass(frozen=True)
class Leftover:
    """Shared memory of an instance whose service is not running."""

    instance: str
    size: int
    owner: str
    ours: bool
    """The service's user could remove it."""


def look(server: User, system: System) -> tuple[tuple[Leftover, ...], tuple[str, ...]]:
    """(what dead runs left, names of the services that run). `server`: who runs the service."""
    runs = _runs(system)
    found = [_leftover(name, dead, server) for name, (_, dead) in runs.items()]
    return tuple(left for left in found if left), tuple(name for name, (lives, _) in runs.items() if lives)


def remove(system: System) -> tuple[list[Leftover], list[Leftover]]:
    """Remove what this user may; returns (removed, left)."""
    found, _ = look(User("", os.geteuid()), system)
    removed: list[Leftover] = []
    left: list[Leftover] = []
    for leftover in found:
        (removed if _remove(leftover.instance, system) else left).append(leftover)
    return removed, left


def _remove(name: str, system: System) -> bool:
    # While its lock is held, no service of this name can start in the middle of this.
    locks: list[int] = []
    try:
        for place in instance.places(name):
            if os.path.exists(instance.lock_path(place)):
                locks.append(claim.open_claims(instance.lock_path(place)))
                if not claim.take(locks[-1], 0):
                    return False
        _, dead = _runs(system).get(name, (False, []))
        for path in dead:
            os.unlink(path)
        return True
    except (InstanceError, OSError):
        return False
    finally:
        for fd in locks:
            os.close(fd)


def _runs(system: System) -> dict[str, tuple[bool, list[str]]]:
    """By instance: whether one of its runs lives, and the files of those that do not."""
    found: dict[str, tuple[bool, list[str]]] = {}
    for file in system.names(SHM):
        prefix, _, rest = file.partition(".")
        name, dot, rest = rest.partition(".")
        with contextlib.suppress(InstanceError):
            if prefix == "failstop" and dot:
                lives, dead = found.get(instance.check_name(name), (False, []))
                if segment.living(f"{name}.{rest.partition('.')[0]}", system.path(SHM)):
                    found[name] = True, dead
                else:
                    found[name] = lives, [*dead, system.path(f"{SHM}/{file}")]
    return found


def _leftover(name: str, paths: list[str], server: User) -> Leftover | None:
    """These files; None: there are none, or they have gone meanwhile."""
    stats = []
    for path in paths:
        with contextlib.suppress(OSError):
            stats.append(os.stat(path))
    if not stats:
        return None
    owner = stats[0].st_uid
    # The sticky bit: only the owner or root removes a name.
    return Leftover(name, sum(found.st_blocks * 512 for found in stats), user(owner).name, server.uid in (0, owner))

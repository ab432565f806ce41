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
    found: list[Leftover] = []
    living: list[str] = []
    for name, runs in _runs(system).items():
        dead = [path for run, files in runs.items() if not _lives(run, system) for path in files]
        if any(_lives(run, system) for run in runs):
            living.append(name)
        if stats := [stat for stat in map(_stat, dead) if stat]:
            found.append(_leftover(name, stats, server))
    return tuple(found), tuple(living)


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
        for run, files in _runs(system).get(name, {}).items():
            for path in files if not _lives(run, system) else ():
                os.unlink(path)
        return True
    except (InstanceError, OSError):
        return False
    finally:
        for fd in locks:
            os.close(fd)


def _runs(system: System) -> dict[str, dict[str, list[str]]]:
    """The files of each run of each instance."""
    found: dict[str, dict[str, list[str]]] = {}
    for file in system.names(SHM):
        prefix, _, rest = file.partition(".")
        name, dot, rest = rest.partition(".")
        with contextlib.suppress(InstanceError):
            if prefix == "failstop" and dot:
                runs = found.setdefault(instance.check_name(name), {})
                runs.setdefault(f"{name}.{rest.partition('.')[0]}", []).append(system.path(f"{SHM}/{file}"))
    return found


def _lives(run: str, system: System) -> bool:
    return segment.living(run, system.path(SHM))


def _stat(path: str) -> os.stat_result | None:
    try:
        return os.stat(path)
    except OSError:
        return None


def _leftover(name: str, stats: list[os.stat_result], server: User) -> Leftover:
    owner = stats[0].st_uid
    # The sticky bit: only the owner or root removes a name.
    return Leftover(name, sum(found.st_blocks * 512 for found in stats), user(owner).name, server.uid in (0, owner))

"""Limits: what this process was given by whoever started it, and needs more of."""

from __future__ import annotations

import resource

DESCRIPTORS = 64
"""What the supervisor has open at most: 47 with every process, segment and bell, 5 of a dead run's, 2 for each of 4
savers, and those that a look at a file takes."""


def take_descriptors() -> None:
    """See to it that DESCRIPTORS can be open; the limit that a process may raise itself is raised. Raises OSError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= DESCRIPTORS:
        return
    if hard != resource.RLIM_INFINITY and hard < DESCRIPTORS:
        raise OSError(no_descriptors(hard))
    resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS, hard))


def no_descriptors(most: int) -> str:
    """What people are told where RLIMIT_NOFILE, `most`, is too low."""
    return (
        f"RLIMIT_NOFILE is {most}, and {DESCRIPTORS} open files are needed: raise it (`ulimit -n 1024`, or "
        "LimitNOFILE= of a systemd unit)"
    )

"""Grant: what a service lacks without its rights, and the one command that gives it those to real-time scheduling and
locked memory, where it runs."""

from __future__ import annotations

import os

from failstop.shm.heartbeat import EARLY_NEWS, REALTIME

UNIT = "`sudo systemctl edit {unit}`, with LimitRTPRIO=40 and LimitMEMLOCK=infinity under [Service]"
CONTAINER = "start the container with `--cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=40 --ulimit memlock=-1`"
SHELL = "`sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited` in the same shell, then start it again"
GRANTED = "it has real-time rights, so look at what else has, and at the host of a virtual machine (`failstop doctor`)"
NO_REALTIME = "no real-time rights (SCHED_FIFO): on a busy machine stops come later, and some for no cause"
NO_EARLY_NEWS = (
    "this kernel tells of a death only once the memory is taken down (no robust futexes): a stop after one comes "
    "later, 1 ms for each 10 MB; run the service on the host's own kernel"
)
CONTAINER_FILES = ("/.dockerenv", "/run/.dockerenv", "/run/.containerenv", "/run/systemd/container")
CONTROL_GROUP = "/proc/self/cgroup"
CONTAINER_VARIABLE = "container"
"""Set for the first process of a container by podman, lxc and systemd-nspawn, and inherited where nobody clears it."""


def advice(*, realtime: bool, managed: bool) -> str:
    """What people are told to do when this process is late, the command in backquotes; `realtime`: it has the rights;
    `managed`: a service manager has started it."""
    if realtime:
        return GRANTED
    command = UNIT.format(unit=own_unit()) if managed else CONTAINER if in_container() else SHELL
    return f"give it real-time rights: {command}"


def lacking(granted: int, advice: str) -> list[tuple[str, str]]:
    """What was not `granted` (heartbeat bits), and what people are told of each."""
    told = ((REALTIME, "SCHED_FIFO", f"{NO_REALTIME}; {advice}"), (EARLY_NEWS, "robust futexes", NO_EARLY_NEWS))
    return [(what, text) for bit, what, text in told if not granted & bit]


def own_unit() -> str:
    """The systemd unit of this process, by its control group; in words where that does not say."""
    try:
        with open(CONTROL_GROUP, encoding="utf-8") as file:
            groups = [line.rstrip().rpartition("/")[2] for line in file]
    except OSError:
        groups = []
    return next((group for group in groups if group.endswith(".service")), "UNIT")


def in_container() -> bool:
    """True when this process runs in one, as far as its kind leaves a sign."""
    return CONTAINER_VARIABLE in os.environ or any(map(os.path.exists, CONTAINER_FILES))

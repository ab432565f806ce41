"""Grant: what a service lacks without its rights, the leases that it can keep without them, and the one command that
gives it those to real-time scheduling and locked memory, where it runs."""

from __future__ import annotations

import os

from failstop.messages.layout import PORT_OWNER
from failstop.policy.processes import BY_NAME, PROCESSES
from failstop.policy.settings import BY_KEY, Settings
from failstop.procs import rights
from failstop.shm.heartbeat import EARLY_NEWS, REALTIME

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Container

LEASE = "gate.lease_s"
LEASE_S = float(BY_KEY[LEASE].default)
LEASE_WITHOUT_S = 0.2
"""The lease without real-time rights, where the settings give none: below the stopper's patience with the port owner
and the supervisor's with the gate (0.25 s), so that who stops first stays who stops first."""
OF_A_TIMEOUT = 0.9
"""The lease takes no more than this share of the shortest command timeout, which is longer than any lease."""

UNIT = "`sudo systemctl edit {unit}`, with LimitRTPRIO=40 and LimitMEMLOCK=infinity under [Service]"
CONTAINER = "start the container with `--cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=40 --ulimit memlock=-1`"
SHELL = "`sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited` in the same shell, then start it again"
GRANTED = "it has real-time rights, so look at what else has, and at the host of a virtual machine (`failstop doctor`)"
NO_REALTIME = "no real-time rights (SCHED_FIFO): on a busy machine stops come later"
NO_EARLY_NEWS = (
    "this kernel tells of a death only once the memory is taken down (no robust futexes): a stop after one comes "
    "later, 1 ms for each 10 MB; run the service on the host's own kernel"
)
CONTAINER_FILES = ("/.dockerenv", "/run/.dockerenv", "/run/.containerenv", "/run/systemd/container")
CONTROL_GROUP = "/proc/self/cgroup"
CONTAINER_VARIABLE = "container"
"""Set for the first process of a container by podman, lxc and systemd-nspawn, and inherited where nobody clears it."""


def advice(*, realtime: bool, managed: bool) -> str:
    """Advice for when this process is late, the command in backquotes; `realtime`: it has the rights;
    `managed`: a service manager has started it."""
    if realtime:
        return GRANTED
    command = UNIT.format(unit=own_unit()) if managed else CONTAINER if in_container() else SHELL
    return f"give it real-time rights: {command}"


def leased(settings: Settings, chosen: Container[str]) -> Settings:
    """The settings with a lease that this process's rights can keep. A lease among the keys that people have `chosen`
    stays as it is."""
    if LEASE in chosen:
        return settings
    with rights.realtime(max(row.priority for row in PROCESSES)) as granted:
        return settings if granted else Settings({**settings.flat(), LEASE: without(settings)})


def without(settings: Settings) -> float:
    """The lease of a service that has no real-time rights, s."""
    timeouts_s = (settings["gate.command_timeout_s"], *(ns / 1e9 for _, ns in settings.sources().values()))
    return max(settings[LEASE], min(LEASE_WITHOUT_S, OF_A_TIMEOUT * min(timeouts_s)))


def cost(lease_s: float) -> str:
    """The price that a service without real-time rights pays for its lease, as a clause."""
    if lease_s > LEASE_S:
        usual = f"{LEASE_S * 1e3:.0f} to {BY_NAME[PORT_OWNER].deadline_ns / 1e6:.0f}"
        late = f"after {lease_s * 1e3:.0f} ms instead of {usual}"
        return f"a hang of gate, supervisor or port owner is stopped for {late} ({LEASE})"
    return f"some have no cause, since {LEASE} is as short as {lease_s * 1e3:.0f} ms"


def lacking(granted: int, advice: str, lease_s: float) -> list[tuple[str, str]]:
    """The rights that were not `granted` (heartbeat bits), with a text for people on each; `lease_s`: the one in
    force."""
    realtime = f"{NO_REALTIME}, and {cost(lease_s)}; {advice}"
    told = ((REALTIME, "SCHED_FIFO", realtime), (EARLY_NEWS, "robust futexes", NO_EARLY_NEWS))
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

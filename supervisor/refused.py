"""Refused: explains why the kernel does not let a process have real-time priority although its limits or capabilities
allow it, and what helps. The reason is either the process's control group (RT_GROUP_SCHED) or a filter of system calls.

If the kernel is built with RT_GROUP_SCHED, each control group with the controller `cpu` has its own share of time for
real-time processes. The share of a new group is zero. With cgroup v1, root can give the group a larger share by writing
to a file. With cgroup v2, there is no such file.
"""

from __future__ import annotations

import os

from failstop.policy.processes import SUPERVISOR_PRIORITY

PROC, GROUP_FOLDER, BOOT = "/proc", "/sys/fs/cgroup", "/boot"
OPTION = "CONFIG_RT_GROUP_SCHED="
SYS_NICE = 23
"""The number of the bit that stands for CAP_SYS_NICE in a set of capabilities."""
FIRST_USERS = ["0", "0", "4294967295"]
"""The fields of /proc/PID/uid_map for a process in the machine's first user namespace. Only in this namespace do
capabilities allow real-time priority."""
RUNTIME = "cpu.rt_runtime_us"
RUNTIME_US = 950000
"""How long the real-time processes of the root group may usually run in each second, in us. The advice suggests the
same for other groups."""

ALLOWED = "its limits allow real-time priority, but"
NO_TIME = f"{ALLOWED} its control group has no time for it (RT_GROUP_SCHED)"
SHELL_V1 = NO_TIME + ": `sudo sh -c '{writes}'`, then start it again in the same shell"
UNIT_V1 = NO_TIME + ": `sudo systemctl edit {unit}`, with ExecStartPre=+/bin/sh -c '{writes}' under [Service]"
CONTAINER_V1 = (
    f"{NO_TIME}: start Docker's daemon with `--cpu-rt-runtime={RUNTIME_US}`, and the container with that option too"
)
V2 = (
    f"{NO_TIME}, and cgroup v2 can give it none: start the kernel with `rt_group_sched=0` (Linux 6.16 on), or use "
    f"a kernel without {OPTION.rstrip('=')}"
)
FILTER = f"{ALLOWED} the kernel refuses it: look at RestrictRealtime= of its unit, or at its container's seccomp filter"


def advice_if_allowed(pid: int | str = "self", *, unit: str = "", container: bool = False, priority: int = 0) -> str:
    """Why the kernel refused a process real-time priority although its limits or capabilities allow it, and what helps.
    Empty if they don't allow it. `unit`: the systemd unit that starts the process. Never raises."""
    if not _allowed(pid, priority or SUPERVISOR_PRIORITY):
        return ""
    for line in _lines(f"{PROC}/{pid}/cgroup"):
        number, _, rest = line.partition(":")
        controllers, _, group = rest.partition(":")
        if "cpu" in controllers.split(",") and _word(_runtime(group)) == "0":
            return _v1(group, unit, container=container)
        if number == "0" and group not in ("", "/") and _of_v2(group):
            return V2
    return FILTER


def _allowed(pid: int | str, priority: int) -> bool:
    """True if the limits or the capabilities of the process allow it the real-time priority `priority`."""
    for line in _lines(f"{PROC}/{pid}/limits"):
        if line.startswith("Max realtime priority"):
            soft = line.split()[3]
            if soft == "unlimited" or (soft.isdigit() and int(soft) >= priority):
                return True
    held = next((line.split()[1] for line in _lines(f"{PROC}/{pid}/status") if line.startswith("CapEff:")), "0")
    users = [line.split() for line in _lines(f"{PROC}/{pid}/uid_map")]
    return users == [FIRST_USERS] and int(held, 16) >> SYS_NICE & 1 == 1


def _v1(group: str, unit: str, *, container: bool) -> str:
    if container and not unit:
        return CONTAINER_V1
    parts = group.strip("/").split("/")
    # Start at the top, because no group can get more than the group above it has.
    above = ["/" + "/".join(parts[: at + 1]) for at in range(len(parts))]
    writes = "; ".join(f"echo {RUNTIME_US} > {_runtime(each)}" for each in above if _word(_runtime(each)) == "0")
    return UNIT_V1.format(unit=unit, writes=writes) if unit else SHELL_V1.format(writes=writes)


def _runtime(group: str) -> str:
    return f"{GROUP_FOLDER}/cpu{group.rstrip('/')}/{RUNTIME}"


def _of_v2(group: str) -> bool:
    """True if a cgroup v2 group has its own share of the processor, and the kernel may have been built with
    RT_GROUP_SCHED."""
    controllers = f"{GROUP_FOLDER}{group}/cgroup.controllers"
    return "cpu" in _word(controllers).split() and _configured()


def _configured() -> bool:
    """True if the kernel may have been built with RT_GROUP_SCHED. False only if the file with the kernel's
    configuration can be read and does not contain the option."""
    lines = _lines(f"{BOOT}/config-{os.uname().release}")
    return not lines or f"{OPTION}y" in lines


def _word(path: str) -> str:
    return "".join(_lines(path)).strip()


def _lines(path: str) -> list[str]:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read().splitlines()
    except OSError:
        return []

"""The checks of the computer: real-time rights, how soon a death is reported, shared memory, the processor, and how
late a process is woken."""

from __future__ import annotations

import os
import platform
import time
from typing import Any

from failstop.doctor.look import Finding, Look, fail, ok, skip, warn
from failstop.doctor.system import SHM
from failstop.instances import unit_of
from failstop.messages import layout
from failstop.supervisor import status
from failstop.version import VERSION

SLOW_GOVERNORS = ("powersave", "conservative", "ondemand")
LATE_US = 5_000.0
"""If a process is woken later than this, us, stops take noticeably longer."""
PROCESSORS = "/sys/devices/system/cpu"
STARVED = "look what else has real-time priority (`ps -eo pid,rtprio,comm`); in a virtual machine, look at its host"


def facts() -> dict[str, Any]:
    """The version of failstop, the date, and the computer's Python, kernel, architecture and number of cores."""
    return {
        "version": VERSION,
        "date": time.strftime("%Y-%m-%d"),
        "python": platform.python_version(),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }


def rights(look: Look) -> list[Finding]:
    """Check whether every process of the running service has real-time priority and locked memory. Without a running
    service, check whether this user can get real-time priority."""
    told = price = ""
    if look.state:
        starved = look.state.starved
        poor = [name for name, row in look.state.processes.items() if not (row.realtime and row.memory_locked)]
        if not poor:
            well = "every process of the service has real-time priority, and its memory is locked"
            return warn(f"{starved}, in spite of real-time priority", "", STARVED) if starved else ok(well)
        told = f"{starved}; " if starved else ""
        lack = f"these processes lack real-time priority or locked memory: {', '.join(poor)}"
        if not all(row.realtime for row in look.state.processes.values()):
            price = f", and {status.cost(look.state.lease_s)}"
    else:
        with look.system.realtime() as granted:
            if granted:
                return ok("this user can get real-time priority")
        lack = "this user can't get real-time priority"
    return warn(f"{told}{lack}; stops come later on a busy machine{price}", *_grant(look))


def _grant(look: Look) -> tuple[str, str]:
    """How to give the service its rights. Returns (a command, what else to do)."""
    managed = look.unit.get("MainPID") == look.pid
    lacks = not look.state or not all(row.realtime for row in look.state.processes.values())
    unit = unit_of(look.name) if look.state and managed else ""
    if by_group := look.system.refused(look.pid, unit) if lacks else "":
        return "", by_group
    if managed:
        lines = "add LimitRTPRIO=40 and LimitMEMLOCK=infinity under [Service]; in a container the host decides"
        return f"sudo systemctl edit {unit_of(look.name)}", lines
    return "", f"give it real-time rights: {status.CONTAINER if look.system.contained() else status.SHELL}"


def early_news(look: Look) -> list[Finding]:
    """Check whether the kernel reports a process's death before it frees the process's memory."""
    if look.system.early_news():
        return ok("the kernel reports a death before it frees the process's memory")
    text = (
        "the kernel reports a process's death late (no robust futexes), so its stop comes 1 ms later for each 10 "
        "MB it used"
    )
    return warn(text, "", "run the service on the host's own kernel, not in gVisor or qemu's user mode")


def shared_memory(look: Look) -> list[Finding]:
    """Check whether /dev/shm has room for the service's shared memory."""
    needed, free = sum(spec.size for spec in layout.SEGMENTS), look.system.room(SHM)
    if free is None:
        fix = "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
        return fail("this user can't write to /dev/shm, so there is no shared memory", fix)
    if free < needed and look.state is None:
        text = f"/dev/shm has {free // 1024} KiB free, but the service needs {needed // 1024}"
        return fail(
            text,
            "ls -lS /dev/shm | head",
            "remove what fills it, or make it larger: sudo mount -o remount,size=75% /dev/shm",
        )
    return ok(f"/dev/shm has room for the {needed // 1024} KiB that the service needs")


def processor(look: Look) -> list[Finding]:
    """Check how the processor's frequency is scaled."""
    files = [f"{PROCESSORS}/{core}/cpufreq/scaling_governor" for core in look.system.names(PROCESSORS)]
    governors = sorted({governor for path in files if (governor := look.system.read(path))})
    if slow := [governor for governor in governors if governor in SLOW_GOVERNORS]:
        fix = f"echo performance | sudo tee {PROCESSORS}/cpu*/cpufreq/scaling_governor"
        text = f"CPU governor {', '.join(slow)}: processes run slowly for some milliseconds after they wake up"
        return warn(text, fix, "this lasts until the next boot; cpupower's service makes it permanent")
    scaled = f"governor {', '.join(governors)}" if governors else "their frequency is not scaled"
    return ok(f"{os.cpu_count()} cores, {scaled}")


def ticks(look: Look) -> list[Finding]:
    """Measure how late this process is woken. The delay must leave the gate enough time within its lease."""
    again = f"failstop {look.again()}"
    if look.quick:
        return skip("not measured (--quick)", again)
    realtime, late_ns = look.system.ticks()
    in_order, last = sorted(late_ns), len(late_ns) - 1
    median_us, p99_us, worst_us = (in_order[round(last * share)] / 1000 for share in (0.5, 0.99, 1.0))
    numbers = f"median {median_us:.0f} us, p99 {p99_us:.0f} us, worst {worst_us:.0f} us ({len(late_ns)} times)"
    text = f"delay of a wake-up {'with' if realtime else 'without'} real-time priority: {numbers}"
    _, found, _ = look.settings
    lease_s = found[status.LEASE]
    if look.state:
        lease_s = look.state.lease_s
    elif not realtime and lease_s == status.LEASE_S:  # a service started from here would use the longer lease
        lease_s = status.lease_without_rights(found)
    spare_us = (lease_s - found["gate.period_s"]) * 1e6
    if worst_us >= spare_us:
        text += f"; after {spare_us / 1000:.0f} ms the lease runs out, and the robot stops for no other reason"
        if realtime:
            advice = "find what keeps the cores busy: a virtual machine, firmware, or a runaway real-time program"
            return fail(text, "top -H", advice)
        return warn(text, "", "give the service real-time priority (see rights)")
    if realtime and worst_us >= LATE_US:
        return warn(text, again, "try again on a quiet machine; if that does not help, use a kernel with PREEMPT_RT")
    return ok(text)

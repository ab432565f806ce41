"""The checks of the machine: rights, clocks, shared memory, processor, and how late a process is woken."""

from __future__ import annotations

import os
import re
import resource

from failstop.doctor.look import Finding, Look, fail, ok, skip, warn
from failstop.doctor.system import SHM
from failstop.shm import layout, segment
from failstop.supervisor import grant

CAP_IPC_LOCK = 14
CAP_SYS_NICE = 23
SLOW_GOVERNORS = ("powersave", "conservative", "ondemand")
SLOW_WAKE_US = 500
"""A processor that sleeps deeper adds more than half of the millisecond in which a stop is to be written."""
LATE_US = 5_000.0
"""A tick later than this shows in the stop times."""
ENOUGH_BYTES = 1 << 30
"""Of memory that may be locked: far more than the service's processes map."""
MICRO = 1e6
PROCESSORS = "/sys/devices/system/cpu"
RUNTIME = "/proc/sys/kernel/sched_rt_runtime_us"
"""Of each second, what real-time processes may use; -1: no limit."""
LIMITS = "/etc/security/limits.d/failstop.conf"
REALTIME = ("rtprio 40", "LimitRTPRIO=40")
LOCKED = ("memlock unlimited", "LimitMEMLOCK=infinity")
"""A limit as /etc/security has it, and as a unit has it."""
STARVED = "look at what else has real-time priority (`ps -eo pid,rtprio,comm`), and at the host of a virtual machine"


def realtime(look: Look) -> list[Finding]:
    """SCHED_FIFO, of the running service if there is one."""
    system = look.system
    if look.state:
        without = [name for name, row in look.state.processes.items() if not row.realtime]
        starved = look.state.starved
        if without:
            told = f"{starved}; " if starved else ""
            text = f"{told}the service runs without real-time priority ({', '.join(without)})"
            return warn(f"{text}: a busy machine delays its stops", *_limit(look, *REALTIME))
        if starved:
            return warn(f"{starved}, in spite of real-time priority", "", STARVED)
        return ok("every process of the service has real-time priority")
    if system.read(RUNTIME) == "0":
        return fail("real-time processes get no time at all", "sudo sysctl kernel.sched_rt_runtime_us=950000")
    with system.realtime() as granted:
        if granted:
            return ok("this user gets real-time priority")
    if system.capable(CAP_SYS_NICE) or system.limit(resource.RLIMIT_RTPRIO):
        text = "real-time priority is refused in spite of limit or capability: a container?"
        return warn(text, "", "run it on the host")
    text = "this user gets no real-time priority: a service run by hand delays its stops on a busy machine"
    return warn(text, *_limit(look, *REALTIME))


def _limit(look: Look, limit: str, unit_line: str) -> tuple[str, str]:
    """The command that raises a limit, and what is to be done besides."""
    if look.service and look.unit.get("MainPID") == str(look.service.pid):
        text = f"its unit should say {unit_line}, as the one of failstop install does"
        return "", f"{text}; in a container the host decides"
    if look.system.in_container():
        return "", grant.CONTAINER
    who = (look.service.user if look.service else "") or look.user.name
    fix = f"echo '{who} - {limit}' | sudo tee -a {LIMITS}"
    return fix, f"then log in again and start the service again; or, until you log out, {grant.SHELL}"


def memory_lock(look: Look) -> list[Finding]:
    """Locked memory, of the running service if there is one."""
    if look.state:
        without = [name for name, row in look.state.processes.items() if not row.memory_locked]
        if without:
            text = f"the service's memory is not locked ({', '.join(without)}): it may be swapped out, and late"
            return warn(text, *_limit(look, *LOCKED))
        return ok("the memory of every process of the service is locked")
    limit = look.system.limit(resource.RLIMIT_MEMLOCK)
    if look.system.capable(CAP_IPC_LOCK) or limit < 0 or limit >= ENOUGH_BYTES:
        return ok("this user may lock memory")
    text = f"this user may lock {limit // 1024} KiB of memory: too little for a service run by hand"
    return warn(text, *_limit(look, *LOCKED))


def early_news(look: Look) -> list[Finding]:
    """How soon the kernel tells of a death."""
    if look.system.early_news():
        return ok("the kernel tells of a death before it takes the memory down")
    text = "the kernel tells of a death late (no robust futexes): a stop after one comes 1 ms later for each 10 MB"
    return warn(text, "", "run the service on the host's own kernel: gVisor and qemu's user mode are such kernels")


def shared_memory(look: Look) -> list[Finding]:
    """/dev/shm can hold the segments."""
    needed, free = sum(spec.size for spec in layout.SEGMENTS), look.system.room(SHM)
    if free is None:
        fix = "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
        return fail("no /dev/shm that this user may write: there is no shared memory", fix)
    if free < needed and look.service is None:
        text = f"/dev/shm has {free // 1024} KiB free, the service needs {needed // 1024}"
        return fail(text, "ls -lS /dev/shm | head", "remove what fills it; or: sudo mount -o remount,size=75% /dev/shm")
    return ok(f"/dev/shm has room for the {needed // 1024} KiB that the service needs")


def left(look: Look) -> list[Finding]:
    """What a dead run of this name left behind."""
    segments = re.compile(rf"failstop\.({look.name}\.[0-9a-f]+)\..+")
    server, found = look.service_user or look.user, []
    for file in look.system.names(SHM):
        if (of := segments.fullmatch(file)) and not segment.living(of[1], look.system.path(SHM)):
            found.append(of[1])
            owner = look.system.owner(f"{SHM}/{file}")
            # The sticky bit: only the owner or root removes a name.
            if server.uid and owner != server.name:
                text = f"shared memory of a dead run of {look.name!r} belongs to {owner}: no start until it is gone"
                return fail(text, f"sudo rm {SHM}/failstop.{of[1]}.*")
    kept = "the last run was killed; the next start keeps what it recorded as an incident"
    return ok(kept if found else "no shared memory of dead runs")


def processor(look: Look) -> list[Finding]:
    """Frequency scaling."""
    files = [f"{PROCESSORS}/{core}/cpufreq/scaling_governor" for core in look.system.names(PROCESSORS)]
    governors = sorted({governor for path in files if (governor := look.system.read(path))})
    if not governors:
        return ok(f"{os.cpu_count()} cores, frequency is not scaled here")
    if slow := [governor for governor in governors if governor in SLOW_GOVERNORS]:
        fix = f"echo performance | sudo tee {PROCESSORS}/cpu*/cpufreq/scaling_governor"
        text = f"CPU governor {', '.join(slow)}: the first milliseconds after a wake-up run slowly"
        return warn(text, fix, "until the next boot; cpupower's service keeps it")
    return ok(f"{os.cpu_count()} cores, governor {', '.join(governors)}")


def idle(look: Look) -> list[Finding]:
    """Sleep states: what waking from the slowest takes that is in use."""
    system, folder = look.system, f"{PROCESSORS}/cpu0/cpuidle"
    used = [f"{folder}/{name}" for name in system.names(folder) if system.read(f"{folder}/{name}/disable") != "1"]
    if not used:
        return ok("no sleep states of the processor are managed here")
    exit_us, path = max((int(system.read(f"{path}/latency") or 0), path) for path in used)
    name = system.read(f"{path}/name") or os.path.basename(path)
    if exit_us > SLOW_WAKE_US:
        return warn(f"idle state {name} takes {exit_us} us to wake from", f"sudo cpupower idle-set -D {SLOW_WAKE_US}")
    return ok(f"the slowest idle state {name} takes {exit_us} us to wake from")


def ticks(look: Look) -> list[Finding]:
    """How late a process is woken: what the lease can bear, and what is good."""
    if look.quick:
        return skip("not measured (--quick)", look.again())
    found = []
    for realtime, late_ns in look.system.ticks():
        found += _judged(realtime, late_ns, look)
    return found if len(found) > 1 else found + skip("real-time priority could not be measured: this user gets none")


def _judged(realtime: bool, late_ns: list[int], look: Look) -> list[Finding]:
    in_order, last = sorted(late_ns), len(late_ns) - 1
    median_us, p99_us, worst_us = (in_order[round(last * share)] / 1000 for share in (0.5, 0.99, 1.0))
    numbers = f"median {median_us:.0f} us, 99 % {p99_us:.0f} us, worst {worst_us:.0f} us of {len(late_ns)}"
    text = f"woken late {'with real-time priority' if realtime else 'at ordinary priority'}: {numbers}"
    _, found, _ = look.settings
    spare_us = (found["gate.lease_s"] - found["gate.period_s"]) * MICRO
    if worst_us >= spare_us:
        text += f"; {spare_us / 1000:.0f} ms and the lease runs out: stops without a cause"
        if realtime:
            advice = "find what holds the cores up: a virtual machine, firmware, a runaway real-time program"
            return fail(text, "top -H", advice)
        return warn(text, "", "give the service real-time priority: see realtime")
    if realtime and worst_us >= LATE_US:
        return warn(text, look.again(), "once more on a quiet machine; then a kernel with PREEMPT_RT")
    return ok(text)

"""The checks of the machine: rights, clocks, shared memory, processor, and how late a process is woken."""

from __future__ import annotations

import os
import resource

from failstop.api import words
from failstop.doctor.finding import SHOWN, Finding, fail, few, ok, skip, warn
from failstop.doctor.look import Look
from failstop.doctor.system import SHM, Ticks
from failstop.shm import layout
from failstop.supervisor import grant

CAP_IPC_LOCK = 14
CAP_SYS_NICE = 23
GOOD_SOURCES = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "xen")
SLOW_GOVERNORS = ("powersave", "conservative", "ondemand")
SLOW_WAKE_US = 500
"""A processor that sleeps deeper adds more than half of the millisecond in which a stop is to be written."""
LATE_US = 5_000.0
"""A tick later than this shows in the stop times."""
ENOUGH_BYTES = 1 << 30
"""Of memory that may be locked: far more than the service's processes map."""
MICRO = 1e6
CLOCKS = "/sys/devices/system/clocksource/clocksource0"
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
        starved = words.starved(look.state.starved)
        if without:
            told = f"{starved}; " if starved else ""
            text = f"{told}the service runs without real-time priority ({', '.join(without)})"
            return warn(f"{text}: a busy machine delays its stops", *_limit(look, *REALTIME))
        if starved:
            return warn(f"{starved}, in spite of real-time priority", "", STARVED)
        return ok("every process of the service has real-time priority")
    if system.number(RUNTIME) == 0:
        return fail("real-time processes get no time at all", "sudo sysctl kernel.sched_rt_runtime_us=950000")
    if system.realtime():
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


def clock(look: Look) -> list[Finding]:
    """The clock that every deadline goes by."""
    source, resolution_ns = look.system.read(f"{CLOCKS}/current_clocksource"), look.system.resolution_ns()
    if resolution_ns > 1000:
        text = f"CLOCK_MONOTONIC has steps of {resolution_ns} ns"
        return fail(text, "", "use a kernel with high-resolution timers")
    if source in GOOD_SOURCES:
        return ok(f"monotonic, clocksource {source}, {resolution_ns} ns")
    available = (look.system.read(f"{CLOCKS}/available_clocksource") or "").split()
    text = f"clocksource {source}: reading it is slow"
    if better := next((name for name in GOOD_SOURCES if name in available), None):
        return warn(text, "", f"add clocksource={better} to the kernel's command line")
    return warn(text, "sudo dmesg | grep -i clocksource", "the kernel's log says why")


def wall_clock(look: Look) -> list[Finding]:
    """Only what people read goes by it."""
    said = look.system.said("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if said is None:
        return skip("nobody says whether the wall clock is synchronized; no stop goes by it")
    if said.strip() == "yes":
        return ok("the wall clock is synchronized")
    text = "the wall clock is not synchronized and may be stepped: no stop goes by it, but the times in journal and "
    advice = "or start another NTP client; in a container the host's clock counts"
    return warn(f"{text}evidence would jump", "sudo timedatectl set-ntp true", advice)


def shared_memory(look: Look) -> list[Finding]:
    """/dev/shm can hold the segments."""
    needed, free = sum(spec.size for spec in layout.SEGMENTS), look.system.free(SHM)
    if free is None:
        return fail("no /dev/shm: there is no shared memory", "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm")
    if not look.system.writable(SHM):
        return fail("this user may not write /dev/shm", "sudo chmod 1777 /dev/shm")
    if free < needed and look.service is None:
        text = f"/dev/shm has {free // 1024} KiB free, the service needs {needed // 1024}"
        return fail(text, "ls -lS /dev/shm | head", "remove what fills it; or: sudo mount -o remount,size=75% /dev/shm")
    return ok(f"/dev/shm has room for the {needed // 1024} KiB that the service needs")


def left(look: Look) -> list[Finding]:
    """What dead runs left behind."""
    own = [run for run in look.runs[0] if run.instance == look.name]
    others = [run for run in look.runs[0] if run.instance != look.name]
    server = look.service_user or look.user
    # The sticky bit: only the owner or root removes a name.
    if blocking := [run for run in own if server.uid not in (0, run.owner.uid)]:
        text = f"shared memory of a dead run of {look.name!r} belongs to {blocking[0].owner.name}"
        return fail(f"{text}: no start until it is gone", f"sudo {_removal([run.memory for run in blocking])}")
    found = []
    for run in own:
        text = f"the last run of {run.instance!r} was killed and left {run.size // 1024} KiB of shared memory"
        found += ok(f"{text}; the next start keeps what it recorded as an incident, and removes it")
    if others:
        names = few(sorted({run.instance for run in others}))
        size = sum(run.size for run in others) // 1024
        sudo = "sudo " if any(run.owner.uid != look.user.uid for run in others) else ""
        found += warn(
            f"shared memory of dead runs of other names: {names} ({size} KiB)",
            f"{sudo}{_removal(sorted(run.memory for run in others))}",
            "what they recorded of their end goes with it; a new start of one keeps that",
        )
    return found or ok("no shared memory of dead runs")


def _removal(memories: list[str]) -> str:
    """Some of them at a time."""
    return " ".join(["rm", *(f"{SHM}/failstop.{memory}.*" for memory in memories[:SHOWN])])


def processor(look: Look) -> list[Finding]:
    """Frequency scaling."""
    cores = _cores(look)
    count = f"{len(cores) or os.cpu_count() or 1} cores"
    governors = sorted({text for core in cores if (text := look.system.read(f"{core}/cpufreq/scaling_governor"))})
    if not governors:
        return ok(f"{count}, frequency is not scaled here")
    if slow := [governor for governor in governors if governor in SLOW_GOVERNORS]:
        fix = f"echo performance | sudo tee {PROCESSORS}/cpu*/cpufreq/scaling_governor"
        text = f"CPU governor {', '.join(slow)}: the first milliseconds after a wake-up run slowly"
        return warn(text, fix, "until the next boot; cpupower's service keeps it")
    return ok(f"{count}, governor {', '.join(governors)}")


def _cores(look: Look) -> list[str]:
    names = look.system.names(PROCESSORS)
    return [f"{PROCESSORS}/{name}" for name in names if name[:3] == "cpu" and name[3:].isdigit()]


def idle(look: Look) -> list[Finding]:
    """Sleep states: what waking from the slowest takes that is in use."""
    system = look.system
    states = [f"{core}/cpuidle/{name}" for core in _cores(look)[:1] for name in system.names(f"{core}/cpuidle")]
    used = [path for path in states if "/state" in path and not system.number(f"{path}/disable")]
    if not used:
        return ok("no sleep states of the processor are managed here")
    exit_us, path = max((system.number(f"{path}/latency") or 0, path) for path in used)
    name = system.read(f"{path}/name") or os.path.basename(path)
    if exit_us > SLOW_WAKE_US:
        return warn(f"idle state {name} takes {exit_us} us to wake from", f"sudo cpupower idle-set -D {SLOW_WAKE_US}")
    return ok(f"the slowest idle state {name} takes {exit_us} us to wake from")


def ticks(look: Look) -> list[Finding]:
    """How late a process is woken: what the lease can bear, and what is good."""
    if look.quick:
        return skip("not measured (--quick)", look.again())
    rows = look.system.ticks()
    found = [finding for row in rows for finding in _ticks(row, look)]
    if not any(row.realtime for row in rows):
        found += skip("real-time priority could not be measured: this user does not get it")
    return found


def _ticks(row: Ticks, look: Look) -> list[Finding]:
    what = "with real-time priority" if row.realtime else "at ordinary priority"
    numbers = f"median {row.median_us:.0f} us, 99 % {row.p99_us:.0f} us, worst {row.worst_us:.0f} us of {row.times}"
    text = f"woken late {what}: {numbers}"
    _, found, _ = look.settings
    spare_us = (found["gate.lease_s"] - found["gate.period_s"]) * MICRO
    if row.worst_us >= spare_us:
        text += f"; {spare_us / 1000:.0f} ms and the lease runs out: stops without a cause"
        if row.realtime:
            advice = "find what holds the cores up: a virtual machine, firmware, a runaway real-time program"
            return fail(text, "top -H", advice)
        return warn(text, "", "give the service real-time priority: see realtime")
    if row.realtime and row.worst_us >= LATE_US:
        return warn(text, look.again(), "once more on a quiet machine; then a kernel with PREEMPT_RT")
    return ok(text)

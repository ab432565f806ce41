"""What the facts of the machine mean. Pure."""

from __future__ import annotations

from failstop.api import words
from failstop.doctor.facts import Facts, Leftover, Ticks, again
from failstop.doctor.finding import Finding, fail, ok, skip, warn
from failstop.supervisor import grant

GOOD_SOURCES = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "xen")
SLOW_GOVERNORS = ("powersave", "conservative", "ondemand")
SLOW_WAKE_US = 500
"""A processor that sleeps deeper adds more than half of the millisecond in which a stop is to be written."""
LATE_US = 5_000.0
"""A tick later than this shows in the stop times."""
ENOUGH_BYTES = 1 << 30
"""Of memory that may be locked: far more than the service's processes map."""
STEP_S = 0.5
GOVERNORS = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
LIMITS = "/etc/security/limits.d/failstop.conf"
STARVED = "look at what else has real-time priority (`ps -eo pid,rtprio,comm`), and at the host of a virtual machine"
SHOWN = 3
MICRO = 1e6
SET_CLOCK = {
    True: ("sudo timedatectl set-ntp true", ""),
    False: ("", "start an NTP client (chrony, ntpd); in a container the host's clock counts"),
}
"""By whether systemd runs."""


def realtime(facts: Facts) -> list[Finding]:
    """SCHED_FIFO, of the running service if there is one."""
    rights = facts.rights
    if facts.state:
        without = [name for name, row in facts.state.processes.items() if not row.realtime]
        starved = words.starved(facts.state.starved)
        if without:
            text = (
                f"the service runs without real-time priority ({', '.join(without)}): a busy machine delays its stops"
            )
            text = f"{starved}; {text}" if starved else text
            return warn(text, *_limit(facts, "rtprio 40", "LimitRTPRIO=40"))
        if starved:
            return warn(f"{starved}, in spite of real-time priority", "", STARVED)
        return ok("every process of the service has real-time priority")
    if rights.runtime_us == 0:
        return fail("real-time processes get no time at all", "sudo sysctl kernel.sched_rt_runtime_us=950000")
    if rights.realtime_granted:
        return ok("this user gets real-time priority")
    if rights.nice_capability or rights.realtime_limit:
        return warn(
            "real-time priority is refused in spite of limit or capability: a container?", "", "run it on the host"
        )
    text = "this user gets no real-time priority: a service run by hand delays its stops on a busy machine"
    return warn(text, *_limit(facts, "rtprio 40", "LimitRTPRIO=40"))


def _limit(facts: Facts, limit: str, unit_line: str) -> tuple[str, str]:
    """The command that raises a limit, and what is to be done besides."""
    if facts.unit and facts.service and facts.unit.main_pid == facts.service.pid:
        return (
            "",
            f"its unit should say {unit_line}, as the one of failstop install does; in a container the host decides",
        )
    if facts.rights.container:
        return "", grant.CONTAINER
    who = (facts.service.user if facts.service else "") or facts.user.name
    fix = f"echo '{who} - {limit}' | sudo tee -a {LIMITS}"
    return fix, f"then log in again and start the service again; or, until you log out, {grant.SHELL}"


def memory_lock(facts: Facts) -> list[Finding]:
    """Locked memory, of the running service if there is one."""
    if facts.state:
        without = [name for name, row in facts.state.processes.items() if not row.memory_locked]
        if without:
            text = f"the service's memory is not locked ({', '.join(without)}): it may be swapped out, and late"
            return warn(text, *_limit(facts, "memlock unlimited", "LimitMEMLOCK=infinity"))
        return ok("the memory of every process of the service is locked")
    limit = facts.rights.memory_limit
    if facts.rights.lock_capability or limit < 0 or limit >= ENOUGH_BYTES:
        return ok("this user may lock memory")
    text = f"this user may lock {limit // 1024} KiB of memory: too little for a service run by hand"
    return warn(text, *_limit(facts, "memlock unlimited", "LimitMEMLOCK=infinity"))


def early_news(facts: Facts) -> list[Finding]:
    """How soon the kernel tells of a death."""
    if facts.rights.early_news:
        return ok("the kernel tells of a death before it takes the memory down")
    text = "the kernel tells of a death late (no robust futexes): a stop after one comes 1 ms later for each 10 MB"
    return warn(text, "", "run the service on the host's own kernel: gVisor and qemu's user mode are such kernels")


def clock(facts: Facts) -> list[Finding]:
    """The clock that every deadline goes by."""
    found = facts.clock
    if found.backward_ns:
        text = f"CLOCK_MONOTONIC went back by {found.backward_ns} ns (clocksource {found.source})"
        return fail(text, "", "add clocksource=hpet to the kernel's command line, and report the machine")
    if found.resolution_ns > 1000:
        text = f"CLOCK_MONOTONIC has steps of {found.resolution_ns} ns"
        return fail(text, "", "use a kernel with high-resolution timers")
    if found.source not in GOOD_SOURCES:
        better = next((name for name in GOOD_SOURCES if name in found.available), None)
        advice = f"add clocksource={better} to the kernel's command line" if better else "the kernel's log says why"
        fix = "" if better else "sudo dmesg | grep -i clocksource"
        return warn(f"clocksource {found.source}: reading it is slow", fix, advice)
    return ok(f"monotonic, clocksource {found.source}, {found.resolution_ns} ns")


def wall_clock(facts: Facts) -> list[Finding]:
    """Only what people read goes by it."""
    found = facts.clock
    harmless = "no stop goes by it, but the times in journal and evidence would jump"
    if found.synchronized is None:
        return skip("the kernel does not say whether the wall clock is synchronized; no stop goes by it")
    if not found.synchronized:
        return warn(f"the wall clock is not synchronized and may be stepped: {harmless}", *SET_CLOCK[facts.systemd])
    if found.offset_s is not None and abs(found.offset_s) >= STEP_S:
        text = f"the wall clock is off by {found.offset_s:.1f} s and may be stepped: {harmless}"
        return warn(text, "sudo chronyc makestep", "if chrony keeps it; else have the NTP client step it")
    return ok("the wall clock is synchronized")


def shared_memory(facts: Facts) -> list[Finding]:
    """/dev/shm can hold the segments."""
    found = facts.memory
    if not found.present:
        return fail("no /dev/shm: there is no shared memory", "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm")
    if not found.writable:
        return fail("this user may not write /dev/shm", "sudo chmod 1777 /dev/shm")
    if found.free is not None and found.free < found.needed and facts.service is None:
        text = f"/dev/shm has {found.free // 1024} KiB free, the service needs {found.needed // 1024}"
        return fail(text, "ls -lS /dev/shm | head", "remove what fills it; or: sudo mount -o remount,size=75% /dev/shm")
    return ok(f"/dev/shm has room for the {found.needed // 1024} KiB that the service needs")


def leftovers(facts: Facts) -> list[Finding]:
    """What dead runs left behind."""
    found = facts.memory.leftovers
    if not found:
        return ok("no shared memory of dead runs")
    blocking = [left for left in found if left.instance == facts.name and not left.ours]
    if blocking:
        text = (
            f"shared memory of a dead run of {facts.name!r} belongs to {blocking[0].owner}: no start until it is gone"
        )
        return fail(text, "sudo failstop doctor --remove-leftovers")
    told = [finding for left in found if left.instance == facts.name for finding in _own(left)]
    others = [left for left in found if left.instance != facts.name]
    return [*told, *_others(others, facts)] if others else told


def _own(left: Leftover) -> list[Finding]:
    text = f"the last run of {left.instance!r} was killed and left {left.size // 1024} KiB of shared memory"
    return ok(f"{text}; the next start keeps what it recorded as an incident, and removes it")


def _others(found: list[Leftover], facts: Facts) -> list[Finding]:
    size = sum(left.size for left in found) // 1024
    names = sorted(left.instance for left in found)
    shown = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
    who = "sudo " if any(left.owner != facts.user.name for left in found) else ""
    return warn(
        f"shared memory of dead runs of other names: {shown} ({size} KiB)",
        f"{who}failstop doctor --remove-leftovers",
        "what they recorded of their end goes with it; a new start of one keeps that",
    )


def cpu(facts: Facts) -> list[Finding]:
    """Frequency scaling."""
    if not facts.cpu.governors:
        return ok(f"{facts.cpu.cores} cores, frequency is not scaled here")
    slow = [governor for governor in facts.cpu.governors if governor in SLOW_GOVERNORS]
    if slow:
        fix = f"echo performance | sudo tee {GOVERNORS}"
        text = f"CPU governor {', '.join(slow)}: the first milliseconds after a wake-up run slowly"
        return warn(text, fix, "until the next boot; cpupower's service keeps it")
    return ok(f"{facts.cpu.cores} cores, governor {', '.join(facts.cpu.governors)}")


def idle(facts: Facts) -> list[Finding]:
    """Sleep states."""
    slowest = facts.cpu.slowest_idle
    if slowest is None:
        return ok("no sleep states of the processor are managed here")
    if slowest.exit_us > SLOW_WAKE_US:
        fix = f"sudo cpupower idle-set -D {SLOW_WAKE_US}"
        return warn(f"idle state {slowest.name} takes {slowest.exit_us} us to wake from", fix)
    return ok(f"the slowest idle state {slowest.name} takes {slowest.exit_us} us to wake from")


def ticks(facts: Facts) -> list[Finding]:
    """How late a process is woken: what the lease can bear, and what is good."""
    if not facts.ticks:
        return skip("not measured (--quick)", again(facts))
    found = [finding for row in facts.ticks for finding in _ticks(row, facts)]
    if not any(row.realtime for row in facts.ticks):
        found += skip("real-time priority could not be measured: this user does not get it")
    return found


def _ticks(row: Ticks, facts: Facts) -> list[Finding]:
    what = "with real-time priority" if row.realtime else "at ordinary priority"
    numbers = f"median {row.median_us:.0f} us, 99 % {row.p99_us:.0f} us, worst {row.worst_us:.0f} us of {row.count}"
    text = f"woken late {what}: {numbers}"
    spare_us = (facts.lease_s - facts.period_s) * MICRO
    if row.worst_us >= spare_us:
        text += f"; {spare_us / 1000:.0f} ms and the lease runs out: stops without a cause"
        if row.realtime:
            advice = "find what holds the cores up: a virtual machine, firmware, a runaway real-time program"
            return fail(text, "top -H", advice)
        return warn(text, "", "give the service real-time priority: see realtime")
    if row.realtime and row.worst_us >= LATE_US:
        return warn(text, again(facts), "once more on a quiet machine; then a kernel with PREEMPT_RT")
    return ok(text)

"""What the facts of the machine mean. Pure."""

from __future__ import annotations

from failstop.doctor.facts import Facts, Ticks
from failstop.doctor.finding import Finding, fail, ok, warn

GOOD_SOURCES = ("tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page", "xen")
SLOW_GOVERNORS = ("powersave", "conservative", "ondemand")
SLOW_WAKE_US = 500
"""A processor that sleeps deeper adds more than half of the millisecond in which a stop is to be written."""
LATE_US = 5_000.0
"""A tick later than this shows in the stop times."""
ENOUGH_BYTES = 1 << 30
"""Of memory that may be locked: far more than the service's processes map."""
STEP_S = 0.5
MICRO = 1e6


def realtime(facts: Facts) -> list[Finding]:
    """SCHED_FIFO, of the running service if there is one."""
    rights = facts.rights
    if facts.service and facts.service.processes:
        without = [row.name for row in facts.service.processes if not row.realtime]
        if without:
            text = (
                f"the service runs without real-time priority ({', '.join(without)}): a busy machine delays its stops"
            )
            return warn(text, "in the unit: LimitRTPRIO=40; from a shell: ulimit -r 40")
        return ok("every process of the service has real-time priority")
    if rights.runtime_us == 0:
        return fail("real-time processes get no time at all", "sudo sysctl kernel.sched_rt_runtime_us=950000")
    if rights.realtime_granted:
        return ok("this user gets real-time priority")
    if rights.nice_capability or rights.realtime_limit:
        return warn("real-time priority is refused in spite of limit or capability: a container?", "run it on the host")
    text = "this user gets no real-time priority: a service run by hand delays its stops on a busy machine"
    return warn(text, f"echo '{facts.user.name} - rtprio 40' | sudo tee -a /etc/security/limits.d/failstop.conf")


def memory_lock(facts: Facts) -> list[Finding]:
    """Locked memory, of the running service if there is one."""
    if facts.service and facts.service.processes:
        without = [row.name for row in facts.service.processes if not row.memory_locked]
        if without:
            text = f"the service's memory is not locked ({', '.join(without)}): it may be swapped out, and late"
            return warn(text, "in the unit: LimitMEMLOCK=infinity; from a shell: ulimit -l unlimited")
        return ok("the memory of every process of the service is locked")
    limit = facts.rights.memory_limit
    if facts.rights.lock_capability or limit < 0 or limit >= ENOUGH_BYTES:
        return ok("this user may lock memory")
    text = f"this user may lock {limit // 1024} KiB of memory: too little for a service run by hand"
    return warn(
        text, f"echo '{facts.user.name} - memlock unlimited' | sudo tee -a /etc/security/limits.d/failstop.conf"
    )


def clock(facts: Facts) -> list[Finding]:
    """The clock that every deadline goes by."""
    found = facts.clock
    if found.backward_ns:
        text = f"CLOCK_MONOTONIC went back by {found.backward_ns} ns (clocksource {found.source})"
        return fail(text, "add clocksource=hpet to the kernel's command line, and report the machine")
    if found.resolution_ns > 1000:
        return fail(
            f"CLOCK_MONOTONIC has steps of {found.resolution_ns} ns", "use a kernel with high-resolution timers"
        )
    if found.source not in GOOD_SOURCES:
        better = next((name for name in GOOD_SOURCES if name in found.available), None)
        fix = f"add clocksource={better} to the kernel's command line" if better else "see dmesg | grep -i clocksource"
        return warn(f"clocksource {found.source}: reading it is slow", fix)
    return ok(f"monotonic, clocksource {found.source}, {found.resolution_ns} ns")


def wall_clock(facts: Facts) -> list[Finding]:
    """Only what people read goes by it."""
    found = facts.clock
    harmless = "no stop goes by it, but times in journal and evidence would jump"
    if found.synchronized is None:
        return ok("the kernel does not say whether the wall clock is synchronized; no stop goes by it")
    if not found.synchronized:
        return warn(f"the wall clock is not synchronized and may be stepped: {harmless}", "timedatectl set-ntp true")
    if found.offset_s is not None and abs(found.offset_s) >= STEP_S:
        return warn(
            f"the wall clock is off by {found.offset_s:.1f} s and may be stepped: {harmless}", "chronyc makestep"
        )
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
        return fail(text, "sudo mount -o remount,size=64M /dev/shm")
    return ok(f"/dev/shm has room for the {found.needed // 1024} KiB that the service needs")


def leftovers(facts: Facts) -> list[Finding]:
    """What dead runs left behind."""
    found = facts.memory.leftovers
    if not found:
        return ok("no shared memory of dead runs")
    size = sum(left.size for left in found) // 1024
    blocking = [left for left in found if left.instance == facts.name and not left.ours]
    if blocking:
        text = (
            f"shared memory of a dead run of {facts.name!r} belongs to {blocking[0].owner}: no start until it is gone"
        )
        return fail(text, f"sudo rm /dev/shm/failstop.{facts.name}.*")
    own = [left for left in found if left.instance == facts.name]
    if len(own) == len(found):
        return ok(f"shared memory of a dead run ({size} KiB); the next start removes it")
    names = sorted({left.instance for left in found} - {facts.name})
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    fix = " ".join(f"/dev/shm/failstop.{name}.*" for name in names[:3])
    return warn(f"shared memory of dead runs: {shown} ({size} KiB)", f"rm {fix}")


def cpu(facts: Facts) -> list[Finding]:
    """Frequency scaling."""
    if not facts.cpu.governors:
        return ok(f"{facts.cpu.cores} cores, frequency is not scaled here")
    slow = [governor for governor in facts.cpu.governors if governor in SLOW_GOVERNORS]
    if slow:
        fix = "sudo cpupower frequency-set -g performance"
        return warn(f"CPU governor {', '.join(slow)}: the first milliseconds after a wake-up run slowly", fix)
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
    found = [finding for row in facts.ticks for finding in _ticks(row, facts)]
    if facts.ticks and not any(row.realtime for row in facts.ticks):
        found += ok("real-time priority could not be measured: this user does not get it")
    return found


def _ticks(row: Ticks, facts: Facts) -> list[Finding]:
    what = "with real-time priority" if row.realtime else "at ordinary priority"
    numbers = f"median {row.median_us:.0f} us, 99 % {row.p99_us:.0f} us, worst {row.worst_us:.0f} us of {row.count}"
    text = f"woken late {what}: {numbers}"
    spare_us = (facts.lease_s - facts.period_s) * MICRO
    if row.worst_us >= spare_us:
        text += f"; {spare_us / 1000:.0f} ms and the lease runs out: stops without a cause"
        if row.realtime:
            return fail(text, "find what holds the cores up: a virtual machine, firmware, a runaway real-time program")
        return warn(text, "give the service real-time priority, see above")
    if row.realtime and row.worst_us >= LATE_US:
        return warn(text, "failstop doctor again on a quiet machine; then a kernel with PREEMPT_RT")
    return ok(text)

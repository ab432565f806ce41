"""Facts of the machine: rights, clocks, shared memory, processor."""

from __future__ import annotations

import ctypes
import os
import resource
import struct
import time

from failstop.doctor import leftovers
from failstop.doctor.facts import Clock, Cpu, Idle, Rights, SharedMemory, User
from failstop.doctor.leftovers import SHM
from failstop.doctor.system import System
from failstop.shm import futex, layout
from failstop.supervisor import grant

CAP_IPC_LOCK = 14
CAP_SYS_NICE = 23
READINGS = 20_000
STA_UNSYNC = 0x0040
STA_NANO = 0x2000
_TIMEX = struct.Struct("=i4xqqqqi")
"""The first fields of struct timex on 64-bit Linux (adjtimex(2)): modes, offset, freq, maxerror, esterror, status."""
_TIMEX_BYTES = 512


def rights(system: System) -> Rights:
    """Of this process."""
    capabilities = 0
    for line in (system.read("/proc/self/status") or "").splitlines():
        if line.startswith("CapEff:"):
            capabilities = int(line.split()[1], 16)
    memory = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    return Rights(
        realtime_limit=max(0, resource.getrlimit(resource.RLIMIT_RTPRIO)[0]),
        memory_limit=-1 if memory == resource.RLIM_INFINITY else memory,
        nice_capability=bool(capabilities >> CAP_SYS_NICE & 1),
        lock_capability=bool(capabilities >> CAP_IPC_LOCK & 1),
        realtime_granted=_try_realtime(),
        container=grant.in_container(),
        runtime_us=system.number("/proc/sys/kernel/sched_rt_runtime_us"),
        early_news=futex.proven(),
    )


def _try_realtime() -> bool:
    """Whatever limits and capabilities say, a container or a control group may refuse."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameters)
    return True


def clock(system: System) -> Clock:
    """The clocks, as the kernel tells of them."""
    folder = "/sys/devices/system/clocksource/clocksource0"
    synchronized, offset_s = _ntp()
    return Clock(
        source=system.read(f"{folder}/current_clocksource"),
        available=tuple((system.read(f"{folder}/available_clocksource") or "").split()),
        backward_ns=_furthest_back(),
        resolution_ns=round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9),
        synchronized=synchronized,
        offset_s=offset_s,
    )


def _furthest_back() -> int:
    last = time.monotonic_ns()
    back = 0
    for _ in range(READINGS):
        now = time.monotonic_ns()
        back = max(back, last - now)
        last = now
    return back


def _ntp() -> tuple[bool | None, float | None]:
    """Whether the kernel holds the wall clock for synchronized, and what it still has to correct."""
    buffer = ctypes.create_string_buffer(_TIMEX_BYTES)
    try:
        if ctypes.CDLL(None).adjtimex(buffer) < 0:
            return None, None
    except (AttributeError, OSError):
        return None, None
    _, offset, _, _, _, status = _TIMEX.unpack_from(buffer.raw)
    return not status & STA_UNSYNC, offset / (1e9 if status & STA_NANO else 1e6)


def shared_memory(server: User, system: System) -> SharedMemory:
    """/dev/shm, and what dead runs left in it. `server`: who runs the service."""
    place = system.path(SHM)
    needed = sum(spec.size for spec in layout.SEGMENTS)
    try:
        found = os.statvfs(place)
    except OSError:
        return SharedMemory(False, False, None, needed)
    writable = os.access(place, os.W_OK | os.X_OK)
    return SharedMemory(True, writable, found.f_bavail * found.f_frsize, needed, *leftovers.look(server, system))


def cpu(system: System) -> Cpu:
    """Frequency scaling and sleep states."""
    folder = "/sys/devices/system/cpu"
    cores = [name for name in system.names(folder) if name[:3] == "cpu" and name[3:].isdigit()]
    governors = {system.read(f"{folder}/{core}/cpufreq/scaling_governor") for core in cores} - {None}
    states = [
        Idle(
            system.read(f"{folder}/{core}/cpuidle/{state}/name") or state,
            system.number(f"{folder}/{core}/cpuidle/{state}/latency") or 0,
        )
        for core in cores[:1]
        for state in system.names(f"{folder}/{core}/cpuidle")
        if state.startswith("state") and not system.number(f"{folder}/{core}/cpuidle/{state}/disable")
    ]
    slowest = max(states, key=lambda state: state.exit_us, default=None)
    return Cpu(len(cores) or os.cpu_count() or 1, tuple(sorted(filter(None, governors))), slowest)

"""Starved: decides whether a silent process hangs, or whether it is starved because the machine does not run it. This
is only used after a deadline has passed.

| its state, from the kernel       | processor time since its beat | so the process                             |
|----------------------------------|-------------------------------|--------------------------------------------|
| R: runnable                      | less than half its deadline   | is starved: other processes ran instead    |
| R: runnable                      | half its deadline or more     | hangs: it is in an endless loop            |
| D: waits in the kernel           | less than half its deadline   | is starved: it waits for memory or driver  |
| D: waits in the kernel           | half its deadline or more     | hangs: a healthy turn needs less time      |
| S: sleeps after its bell rang    | any                           | hangs: even its bell did not wake it       |
| T, t, Z, X: stopped or dead      | any                           | hangs                                      |
| unknown: nothing can be read     | any                           | hangs: an unknown state excuses nothing    |

A healthy turn needs less processor time than half of the deadline. If the process sleeps, its bell is rung before its
state is read again. A timer may come late while a virtual machine has lost its core, but a bell wakes the process at
once.
"""

from __future__ import annotations

from time import clock_gettime_ns

from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.thread_state import state_of

LONGEST_NS = 5_000_000_000
"""How long a starved process may be silent after its deadline before it is replaced in any case."""
_CPU_CLOCK = 2
"""Selects the exact processor time of a process in clock_gettime(2). The clock's number is the inverted pid, shifted
left by 3, plus this value in the lowest bits."""


def starved(state: str, ran_ns: int, deadline_ns: int) -> bool:
    """Return True if the process is starved, by the table at the top of this file. `state`: the letter from the kernel.
    `ran_ns`: its processor time since its last beat. Pure."""
    return state in ("R", "D") and ran_ns < deadline_ns // 2


def look(pid: int, heart: HeartbeatReader, deadline_ns: int, bell: EventBell) -> bool:
    """Return True if the silent process `pid` is starved. `bell`: wakes the process if it sleeps. This takes about 20
    us."""
    try:
        # If a starting process has not beaten yet, this value is still from the process before it.
        before_ns = heart.cpu_ns.get() if heart.pid.get() == pid else 0
        ran_ns = clock_gettime_ns(~pid << 3 | _CPU_CLOCK) - before_ns
        state = state_of(pid)
        if state == "S":
            bell.ring()
            state = state_of(pid)
    except (OSError, IndexError):
        return False
    return starved(state, ran_ns, deadline_ns)

"""Starved: was a silent process not run by the machine, or does it hang? Asked only when a deadline has passed.

| the kernel says of it            | processor time since its beat | so it                                     |
|----------------------------------|-------------------------------|-------------------------------------------|
| R: runnable                      | less than half its deadline   | is starved: others were run instead       |
| R: runnable                      | more                          | hangs: an endless loop                    |
| D: waits in the kernel           | less than half its deadline   | is starved: of its memory, or by a driver |
| S: sleeps, after it was rung for | any                           | hangs: it waits for what does not come    |
| T, t, Z, X: stopped, dead        | any                           | hangs                                     |
| nothing that can be read         | any                           | hangs: what is not known excuses nobody   |

A deadline is given for a turn that nobody delays, so half of it in processor time is more than a healthy turn takes.
Who sleeps is rung for and looked at again: a timer is late while a virtual machine's core is away, a bell is not.
"""

from __future__ import annotations

from time import clock_gettime_ns

from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.thread_state import state_of

LONGEST_NS = 5_000_000_000
"""A process that is silent for longer than this past its deadline is replaced, whatever the machine does."""
_CPU_CLOCK = 2
"""clock_gettime(2): a process's clock is ~pid << 3 with the kind in the lowest bits, here the exact time run."""


def starved(state: str, ran_ns: int, deadline_ns: int) -> bool:
    """The table above; `ran_ns`: its processor time since its last beat. Pure."""
    return state in ("R", "D") and ran_ns < deadline_ns // 2


def look(pid: int, heart: HeartbeatReader, deadline_ns: int, bell: EventBell) -> bool:
    """True if the silent process is starved. `bell`: the bell that wakes that process. Takes two readings, about 20
    us."""
    try:
        # A starting process has not beaten yet, so the value there is its predecessor's.
        before_ns = heart.cpu_ns.get() if heart.pid.get() == pid else 0
        ran_ns = clock_gettime_ns(~pid << 3 | _CPU_CLOCK) - before_ns
        state = state_of(pid)
        if state == "S":
            bell.ring()
            state = state_of(pid)
    except (OSError, IndexError):
        return False
    return starved(state, ran_ns, deadline_ns)

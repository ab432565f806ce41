"""Starved: tells whether the machine did not run a silent process, or whether the process hangs. Only used when a
deadline has passed.

| the kernel says of it            | processor time since its beat | so it                                     |
|----------------------------------|-------------------------------|-------------------------------------------|
| R: runnable                      | less than half its deadline   | is starved: others were run instead       |
| R: runnable                      | more                          | hangs: an endless loop                    |
| D: waits in the kernel           | less than half its deadline   | is starved: of its memory, or by a driver |
| S: sleeps, after it was rung for | any                           | hangs: it waits for what does not come    |
| T, t, Z, X: stopped, dead        | any                           | hangs                                     |
| nothing that can be read         | any                           | hangs: what is not known excuses nobody   |

A healthy turn needs less processor time than half of its deadline. If the process sleeps, its bell is rung and it is
looked at once more: while a virtual machine has lost its core, a timer may come late, but a bell does not.
"""

from __future__ import annotations

from time import clock_gettime_ns

from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.thread_state import state_of

LONGEST_NS = 5_000_000_000
"""A process that is silent for longer than this past its deadline is replaced, whatever the machine does."""
_CPU_CLOCK = 2
"""The clock of a process for clock_gettime(2): its pid, inverted and shifted left by 3, with the kind of clock in the
lowest bits. This kind is the exact processor time."""


def starved(state: str, ran_ns: int, deadline_ns: int) -> bool:
    """True if the process is starved, according to the table above. `ran_ns`: its processor time since its last beat.
    Pure."""
    return state in ("R", "D") and ran_ns < deadline_ns // 2


def look(pid: int, heart: HeartbeatReader, deadline_ns: int, bell: EventBell) -> bool:
    """True if a silent process is starved. `bell`: the bell that wakes it. Takes two readings, about 20 us."""
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

"""Survivors that no test needs to notice, and why.

A row that says `same` is for mutants that are the same program: they don't count. The others are explained, and count.
`changed` is searched in the mutant's changed lines: the removed ones (`-    text`), then the added (`+    text`).
"""

from __future__ import annotations

from typing import NamedTuple


class Reason(NamedTuple):
    """Which files (a pattern), which changes (a regular expression), why, and whether it's the same program."""

    path: str
    changed: str
    why: str
    same: bool = True


EVERYWHERE = (
    Reason("*", r"^-.*(fd|_port) (<|>=) 0.*\n\+.*(fd|_port) (<=|>) 0", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("*", r"^-.*(fd|_port) (<|>=) 0.*\n\+.*(fd|_port) (<|>=) 1", "0, 1 and 2 are open: no descriptor here is 0"),
    Reason("*", r"^-\s+\w+ = False\n\+\s+\w+ = None$", "both are false"),
)

PROCS: tuple[Reason, ...] = ()

SHM: tuple[Reason, ...] = (
    Reason("shm/bell.py", r"\n\+.*os\.read\(self\.fd, 9\)", "an eventfd gives 8 bytes"),
    Reason("shm/box.py", r"\n\+.*payload\[0\] if payload else 1\)", "what is empty is refused by its size"),
    Reason("shm/box.py", r"\n\+.*zip\(times\[:5\], times\[5:\], (strict=False)?\)", "both halves are of five"),
    Reason("shm/box.py", r"\n\+.*3e\+38", "the same number"),
    Reason("shm/box.py", r"\n\+.*min\(max\(1, now_ns", "0 and 1 ns are both 0 us"),
    Reason("shm/heartbeat.py", r"\n\+.*if gap >= self\._worst_ns", "the gap that is written already is written again"),
    Reason("shm/instance.py", r"\n\+\s+fd = -2$", "no descriptor is below 0"),
    Reason("shm/instance.py", r"\n\+.*ftruncate\(fd, 1\)", "the line that is written then begins at byte 0"),
    Reason("shm/instance.py", r"\n\+.*int\(os\.pread\(fd, 17, 0\)", "int() takes the line's end, the 17th byte"),
    Reason("shm/instance.py", r"\n\+.*os\.pread\(fd, 33, 0\)", "no pid has 32 digits", same=False),
    Reason("shm/latest.py", r"\n\+\s+self\._seen = 1$", "the numbers begin at 1"),
    Reason("shm/latest.py", r"\n\+.*in range\(4\):", "one more try", same=False),
    Reason("shm/latest.py", r"\n\+.*slot\.sequence\(raw, \) else 0", "0 is the default"),
    Reason("shm/latest.py", r"\n\+.*size\) >= slot\.sequence\(raw, 0\)", "only empty ones are alike", same=False),
    Reason("shm/layout.py", r"\n\+.*(capacity: int = 9|slots: int = 2)", "read only by the hash there", same=False),
    Reason(
        "shm/layout.py",
        r"\n\+.*_latest\(.(command|sensed|interlocks|request|said)., (65|225|321|401), ",
        "room for a byte more",
        same=False,
    ),
    Reason("shm/layout.py", r"\n\+.*crc32\(data, 23295\)", "any start of the second sum will do", same=False),
    Reason("shm/lifeline.py", r"\n\+.*poll\.register\(self\.fd, \)", "a pidfd has no events but this one"),
    Reason("shm/lifeline.py", r"\n\+.*timeout_s \* 1001", "longer by a thousandth", same=False),
    Reason("shm/mutex.py", r"^-.*_setpshared\(", "glibc shares every robust mutex", same=False),
    Reason("shm/mutex.py", r"\n\+.*memset\(.*, 1, MUTEX_BYTES\)", "pthread_mutex_init sets all of it"),
    Reason("shm/mutex.py", r"\n\+.*_mutexattr_destroy\(None\)", "nothing is to be given back: glibc's does nothing"),
    Reason("shm/ring.py", r"\n\+\s+laps = 1$", "in a chase it goes closer to the newest one step sooner", same=False),
    Reason("shm/ring.py", r"\n\+.*if seq >= self\._next\]", "found now, and not at the next look", same=False),
    Reason("shm/segment.py", r"\n\+.*PROT_WRITE if write else 1\)", "1 is PROT_READ"),
    Reason("shm/segment.py", r"\n\+.*mmap\(fd, spec\.size, prot=prot\)", "MAP_SHARED is the default"),
    Reason("shm/segment.py", r"\n\+.*found\.get\(.*, 1\)\)", "no file is of the first nanosecond of 1970"),
)

SUPERVISOR: tuple[Reason, ...] = ()

REASONS = (*EVERYWHERE, *PROCS, *SHM, *SUPERVISOR)

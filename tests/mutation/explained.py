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

PROCS: tuple[Reason, ...] = (
    Reason("procs/stopper/main.py", r"\+.*ready\.get\(self\._port, 1\) & GONE", "1 is none of GONE's bits"),
    Reason("procs/stopper/main.py", r"\+.*\*self\._due\[:2\],", "they are in order, and min() takes the first"),
    Reason("procs/stopper/main.py", r"\+\s+self\._stopped_for = 1$", "each burst for a port owner sets it"),
    Reason("procs/stopper/main.py", r"\+.*_port_owner_hangs = True$", "the first turn clears it: nobody hangs so soon"),
    Reason("procs/stopper/rest.py", r"\+.*_wait\(\[fd\], 1\.0\)", "a second after the boot is over as well"),
    Reason("procs/stopper/rest.py", r'\+.*line\.split\(b":", (3)?\)\[1\]', "what is cut off behind is not looked at"),
    Reason(
        "procs/stopper/rest.py", r"\+\s+poll\.register\(fd, \)", "a pidfd is ready for nothing but its process's end"
    ),
    Reason("procs/stopper/rest.py", r"\+.*time\.monotonic\(\)\) \* 1001\)", "it waits a thousandth longer", same=False),
    Reason("procs/stopper/tool.py", r"\+\s+wait_s = -2\.0", "whatever is below zero says that nobody was asked"),
    Reason("procs/stopper/tool.py", r"\+.*if wait_s <= 0 else", "after an answer of 0 there is no further try"),
    Reason("procs/stopper/tool.py", r"\+.*waited_s > WARN_S", "the warning comes one try later at most", same=False),
    Reason("procs/stopper/tool.py", r"\+.*if \(left\) or True else", "a write of no bytes writes nothing"),
    Reason(
        "procs/stopper/tool.py",
        r"\+.*time\.monotonic\(\) >= until_s",
        "it gives up one look earlier at most",
        same=False,
    ),
    Reason("procs/stopper/tool.py", r"\+.*error\.errno or 1\)", "what the system raises has a number"),
    Reason("procs/port_owner/main.py", r"\+.*ready\.get\(self\.wire\.fd, 1\)", "it reads more often", same=False),
    Reason("procs/port_owner/main.py", r"\+.*if events \| READ and", "it reads more often", same=False),
    Reason("procs/port_owner/main.py", r'\+.*split\(b"\\n", (2)?\)\[0\]', "what is cut off behind is not looked at"),
    Reason("procs/port_owner/main.py", r"\+.* / 10+1\.0:\.", "a millionth of a time that people read", same=False),
    Reason("procs/port_owner/main.py", r"\+\s+return slept_ns > 1$", "a sleep is 0 or at least SLEPT_NS"),
    Reason("procs/port_owner/main.py", r"\+\s+motion = None$", "both are false"),
    Reason("procs/port_owner/main.py", r"\+\s+motion_(ns|epoch) = 1$", "it is read only with a frame, which sets it"),
    Reason("procs/port_owner/main.py", r"\+.*self\._finder\.open\(now_ns\)\) (> 0|>= 1):", "no descriptor here is 0"),
    Reason(
        "procs/port_owner/main.py", r"\+\s+self\._moved_ns = 1$", "it is read only while moving, and motion sets it"
    ),
    Reason(
        "procs/port_owner/main.py", r"\+\s+self\._stuck = True$", "no port is stuck at the first look, which clears it"
    ),
    Reason("procs/port_owner/main.py", r"\+\s+self\._watched = \((\+1|-2), 0\)$", "no port has that number either"),
    Reason("procs/port_owner/main.py", r"\+\s+self\._watched = \(-1, 1\)$", "no port has the number -1"),
    Reason(
        "procs/port_owner/wire.py",
        r"^-    self\._handed = 0\n\+    self\._handed = 1$",
        "a byte more, until it has drained once",
        same=False,
    ),
    Reason("procs/port_owner/wire.py", r"\+.*max\(self\._handed, 2\)", "nobody allows a backlog of one byte"),
    Reason("procs/port_owner/wire.py", r"\+.*os\.read\(self\.fd, 4097\)", "one byte more at a time", same=False),
    Reason("procs/gate/core.py", r"\+.*self\._limits, self\._ramps, (strict=False)?\)", "all four have three axes"),
    Reason("procs/gate/core.py", r"\+.*zip\(limits, kinematics\.axes, (strict=False)?\)", "both have three axes"),
    Reason("procs/gate/core.py", r"\+\s+if want >= now:", "at equality both branches return it"),
    Reason("procs/gate/core.py", r"\+\s+self\.latched_in = 1$", "it is set with every latch, and read while latched"),
    Reason("procs/gate/core.py", r"\+\s+self\.epoch = 1$", "it is set by enable, and read only while enabled"),
    Reason("procs/gate/core.py", r"\+\s+self\._sent_ns = 1$", "one nanosecond after the boot is as long ago"),
    Reason("procs/gate/interlocks.py", r"\+.*\.get\(name, 1\)", "one nanosecond after the boot is as long ago"),
)

SHM: tuple[Reason, ...] = ()

SUPERVISOR: tuple[Reason, ...] = ()

REASONS = (*EVERYWHERE, *PROCS, *SHM, *SUPERVISOR)

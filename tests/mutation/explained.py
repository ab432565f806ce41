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
)

SHM: tuple[Reason, ...] = ()

SUPERVISOR: tuple[Reason, ...] = ()

REASONS = (*EVERYWHERE, *PROCS, *SHM, *SUPERVISOR)

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

SHM: tuple[Reason, ...] = ()

SUPERVISOR: tuple[Reason, ...] = ()

REASONS = (*EVERYWHERE, *PROCS, *SHM, *SUPERVISOR)

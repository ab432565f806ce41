"""The verdict on a run: which survivors are the same program, which are explained, and which nothing explains."""

from __future__ import annotations

import re
from collections import Counter
from fnmatch import fnmatch
from typing import NamedTuple

from tests.mutation.explained import REASONS, Reason

MOST = 0.03
# mutmut's codes. Not called: no test of the room calls this function. Not tried: the run or its tests went wrong.
SURVIVED, NOT_CALLED = 0, 33
NOT_TRIED = (None, 4, 35, 255)
OF_THE_SERVICE = ".x_run"
"""A process's run(): only the running service calls it."""


class Outcome(NamedTuple):
    """One mutant: its file under the root, mutmut's name and code for it, its changed lines (- and + before them)."""

    path: str
    name: str
    code: int | None
    changed: str


def reason(it: Outcome) -> Reason | None:
    """The first row that this mutant is of."""
    return next((row for row in REASONS if fnmatch(it.path, row.path) and re.search(row.changed, it.changed)), None)


def report(outcomes: list[Outcome]) -> int:
    """Print each survivor that nothing explains, and the counts; 0 when the bar is met."""
    survived = [(it, reason(it)) for it in outcomes if it.code == SURVIVED]
    same = [it for it, why in survived if why and why.same]
    unexplained = [it for it, why in survived if not why]
    for it in unexplained:
        print(f"# {it.name}\n{it.changed}\n")
    uncalled = Counter(it.name.rpartition("__mutmut_")[0] for it in outcomes if it.code == NOT_CALLED)
    missed = [name for name in uncalled if not name.endswith(OF_THE_SERVICE)]
    for name, count in uncalled.items():
        why = "no test of these rooms calls it (rooms.py)" if name in missed else "only the running service calls it"
        print(f"{name}: {count} mutants were not judged, because {why}")
    untried = Counter(it.path for it in outcomes if it.code in NOT_TRIED)
    for path, count in untried.items():
        print(f"{path}: {count} mutants were not tried")
    judged = len(outcomes) - len(same) - uncalled.total() - untried.total()
    real = len(survived) - len(same)
    share = real / judged if judged else 1.0
    print(
        f"{judged} mutants judged, {real} survived: {share:.1%}, at most {MOST:.0%} may; "
        f"{len(unexplained)} of them unexplained; {len(same)} more are the same program"
    )
    return 1 if share > MOST or unexplained or untried or missed else 0

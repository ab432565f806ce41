"""The verdict on a run: which survivors are the same program, which are explained, and which nothing explains."""

from __future__ import annotations

import re
from collections import Counter
from fnmatch import fnmatch
from typing import NamedTuple

from tests.mutation.explained import REASONS, Reason

MOST = 0.03
# mutmut's codes. Not called: only the running service calls this function. Not tried: the run or its tests went wrong.
SURVIVED, NOT_CALLED = 0, 33
NOT_TRIED = (None, 4, 35, 255)


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
    uncalled = Counter(it.path for it in outcomes if it.code == NOT_CALLED)
    for path, count in uncalled.items():
        print(f"{path}: {count} mutants of functions that only the running service calls, not judged")
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
    return 1 if share > MOST or unexplained or untried else 0

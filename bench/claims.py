"""Claims that rows of the bench carry: by the pattern that a row's measure begins with, the first that fits."""

from __future__ import annotations

import re

CLAIMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"kill \w+ while the arm moves", ("ARM-1",)),
    ("kill ", ("DEATH-1",)),
    ("hang of ", ("HANG-1",)),
    ("stop request ", ("ASK-1",)),
    ("exec of `failstop run`", ("START-1",)),
    ("replug ", ("PORT-1",)),
    (r"last drive\(\) -> zero frame", ("CLIENT-1",)),
    ("stops missed", ("DEATH-1", "HANG-1")),
    ("motion frames after", ("MOVE-2",)),
)
"""A row that no line fits carries none."""


def claims_of(measure: str) -> tuple[str, ...]:
    """The names of the claims that a row of this measure carries (failstop/lab/case/claims.py)."""
    return next((claims for begins, claims in CLAIMS if re.match(begins, measure)), ())

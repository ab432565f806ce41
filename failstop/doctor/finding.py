"""A finding: what a check has to say, and what helps: a command, or what a person is to do."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import partial

OK = "ok"
SKIP = "skip"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, SKIP, WARN, FAIL)
"""fail: a stop may be missing or late, or the service can't run; warn: it runs, with less certainty than it could;
skip: nobody has looked, or there is nothing here to look at; ok: looked at, and well."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line."""

    level: str
    text: str
    fix: str = ""
    """A command that can be pasted into a shell; empty where none helps."""
    advice: str = ""
    """What a person is to do, or to know of the command."""


def _found(level: str, text: str, fix: str = "", advice: str = "") -> list[Finding]:
    return [Finding(level, text, fix, advice)]


ok, skip, warn, fail = (partial(_found, level) for level in LEVELS)
"""What a check returns: text, fix, advice."""


def worst(levels: Iterable[str]) -> str:
    """The most serious of these; ok when there are none."""
    return max(levels, key=LEVELS.index, default=OK)

"""A finding: what a check has to say, and what helps: a command, or what a person is to do."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

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


def ok(text: str) -> list[Finding]:
    """All is well."""
    return [Finding(OK, text)]


def skip(text: str, fix: str = "", advice: str = "") -> list[Finding]:
    """Not known; it may be well or not."""
    return [Finding(SKIP, text, fix, advice)]


def warn(text: str, fix: str = "", advice: str = "") -> list[Finding]:
    """It works, but not as well as it could."""
    return [Finding(WARN, text, fix, advice)]


def fail(text: str, fix: str = "", advice: str = "") -> list[Finding]:
    """It can't be relied on like this."""
    return [Finding(FAIL, text, fix, advice)]


def worst(levels: Iterable[str]) -> str:
    """The most serious of these; ok when there are none."""
    return max(levels, key=LEVELS.index, default=OK)

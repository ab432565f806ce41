"""A finding: what a check has to say, and the command that helps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

OK = "ok"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, WARN, FAIL)
"""fail: a stop may be missing or late, or the service can't run; warn: it runs, with less certainty than it could."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line."""

    level: str
    text: str
    fix: str = ""
    """A command, or what a person is to do; empty when there is nothing to do."""


def ok(text: str) -> list[Finding]:
    """All is well."""
    return [Finding(OK, text)]


def warn(text: str, fix: str) -> list[Finding]:
    """It works, but not as well as it could."""
    return [Finding(WARN, text, fix)]


def fail(text: str, fix: str) -> list[Finding]:
    """It can't be relied on like this."""
    return [Finding(FAIL, text, fix)]


def worst(levels: Iterable[str]) -> str:
    """The most serious of these; ok when there are none."""
    return max(levels, key=LEVELS.index, default=OK)

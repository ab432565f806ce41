"""A finding: what a check has to say, and what helps: a command, or what a person is to do."""

from __future__ import annotations

import dataclasses
import re
from functools import partial

OK = "ok"
SKIP = "skip"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, SKIP, WARN, FAIL)
"""fail: a stop may be missing or late, or the service can't run; warn: it runs, with less certainty than it could;
skip: nobody has looked, or there is nothing here to look at; ok: looked at, and well."""
_OWN = re.compile(r"(?<![\w/.'@-])failstop (?=[a-z-]+)")


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


def pasteable(fix: str, command: str, *, root: bool) -> str:
    """A command that says `failstop` and `sudo`, with the program called as it is here, and for root without sudo."""
    given = fix.replace("sudo ", "") if root else fix
    return _OWN.sub(f"{command} ", given)

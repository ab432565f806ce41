"""The subcommands of `failstop` that need the laboratory, and what several of them do with their options."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Mapping
from typing import TypeVar

from failstop.api.errors import FailstopError

T = TypeVar("T")


def matching(only: str | None, known: Mapping[str, T], missing: str) -> list[T]:
    """The names that the patterns of an option choose, in the order of `known`; everything without them. `missing`: the
    refusal of a pattern that chooses nothing, with a place for it. Raises FailstopError."""
    if only is None:
        return list(known.values())
    found: set[str] = set()
    for pattern in only.split(","):
        names = fnmatch.filter(known, pattern)
        if not names:
            raise FailstopError(missing.format(repr(pattern)))
        found.update(names)
    return [value for name, value in known.items() if name in found]


def write_json(path: str, found: object) -> None:
    """At the end: the result, for programs. Raises FailstopError, because an OSError of a full disk would be taken for
    one of standard output."""
    try:
        with open(path, "w", encoding="utf-8") as file:
            json.dump(found, file, indent=1)
    except OSError as error:
        raise FailstopError(f"--json {path} could not be written: {error.strerror}") from None


def check_json(path: str | None) -> None:
    """Before anything moves: the result of hours can be written there at their end. Raises FailstopError."""
    if path is None:
        return
    try:
        with open(path, "a", encoding="utf-8"):
            pass
    except OSError as error:
        raise FailstopError(f"--json {path}: {error.strerror}") from None

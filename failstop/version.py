"""The version of this package, in the one place that both the build and the running processes read; and the public
names that the next minor version may take away (SECURITY.md has the rule)."""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

VERSION = "0.1.0"

DEPRECATED: dict[str, str] = {}
"""Options, as `drive --for`, and settings, as `gate.lease_s`: each is taken till then, for the one to use instead."""


def renewed(word: str) -> str:
    """Return what to use instead of a deprecated word, and say so on standard error; any other word as it is."""
    new = DEPRECATED.get(word)
    if new is None:
        return word
    sys.stderr.write(f"failstop: {word} is deprecated, and the next minor version may refuse it: use {new}\n")
    return new


def options(command: str, words: list[str]) -> list[str]:
    """Return the words behind a command with today's options for deprecated ones, also in `--option=value`."""
    parts = [word.partition("=") for word in words]
    return [renewed(f"{command} {flag}").removeprefix(f"{command} ") + sign + value for flag, sign, value in parts]


class Renamed:
    """The old name of an attribute or method: it gives what the new one does, with a DeprecationWarning."""

    def __init__(self, new: str) -> None:
        self.new = new
        self.old = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = name

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        if instance is None:
            return self
        import warnings

        old = f"{type(instance).__name__}.{self.old}"
        text = f"{old} is deprecated, and the next minor version may lack it: use {self.new}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return getattr(instance, self.new)

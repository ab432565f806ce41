"""The version of failstop, and the public names that are deprecated. The build reads the version here too. SECURITY.md
says how long a deprecated name keeps working."""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

VERSION = "0.1.0"

DEPRECATED: dict[str, str] = {}
"""The deprecated names, each with the name to use instead. Options are written with their command, as in `drive --for`,
and settings by their whole key, as in `gate.lease_s`. They keep working until the next minor version."""


def renewed(word: str) -> str:
    """Return the new name for a deprecated one, and print a warning on standard error. Any other name is returned
    unchanged."""
    new = DEPRECATED.get(word)
    if new is None:
        return word
    sys.stderr.write(f"failstop: {word} is deprecated, and the next minor version may refuse it: use {new}\n")
    return new


def options(command: str, words: list[str]) -> list[str]:
    """Return the arguments of a command with the new names of deprecated options, also in `--option=value`."""
    parts = [word.partition("=") for word in words]
    return [renewed(f"{command} {flag}").removeprefix(f"{command} ") + sign + value for flag, sign, value in parts]


class Renamed:
    """Keeps the old name of an attribute or method working, with a DeprecationWarning."""

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

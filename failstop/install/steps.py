"""What installing and uninstalling are made of: steps, as data. do.py knows how to do and undo each kind.

Paths are those of the installed system, absolute, whatever directory the system's root is in now.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Step:
    """A verb, what it is done to (a path, a unit, or words for people), a remark. Without a verb it is not shown."""

    verb: str
    subject: str
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class Directory(Step):
    """Make one directory, mode 0755."""


@dataclasses.dataclass(frozen=True)
class File(Step):
    """Write a file, whole or not at all, mode 0644, over what is there."""

    data: bytes = b""


@dataclasses.dataclass(frozen=True)
class Link(Step):
    """Make a symbolic link, over a link or file that is there."""

    target: str = ""


@dataclasses.dataclass(frozen=True)
class Tree(Step):
    """Put the Python environment in the place of what is there, with the list of what is installed in it."""

    manifest: bytes = b""


@dataclasses.dataclass(frozen=True)
class Remove(Step):
    """Remove a file, a link or a whole directory; nothing there is well too."""

    only_empty: bool = False
    """A directory that still holds something stays."""


@dataclasses.dataclass(frozen=True)
class Command(Step):
    """Run a program of the system."""

    words: tuple[str, ...] = ()
    """Empty: nothing now; there is only something to undo."""
    undo: tuple[str, ...] = ()
    touches: tuple[str, ...] = ()
    """Files that it may write; they are put back as they were when it is undone."""
    accepted: tuple[int, ...] = (0,)
    """Exit codes that are well."""


@dataclasses.dataclass(frozen=True)
class Start(Step):
    """Start a unit and wait until it is ready. Undone by stopping it."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """The steps in their order, and what to say besides."""

    steps: tuple[Step, ...]
    notes: tuple[str, ...] = ()
    restarts: tuple[str, ...] = ()
    """Units that run now and are stopped for it: the wheels stop, and motion has to be enabled again."""

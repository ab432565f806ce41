"""Own: a board that a folder of the user's describes, by a module wire.py with a Wire named WIRE.

Its modules import each other with a dot (`from . import codec`) and failstop's as any program does. They run in every
process of the service, so whoever may write them may drive: the folder and everything above it belongs to root or to
the service's user, and nobody else may write there.
"""

from __future__ import annotations

import os
import stat
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from failstop.board.wire import Wire

OWN_PACKAGE = "failstop_own_board"
"""The name under which Python knows it."""


class OwnBoardError(ValueError):
    """The folder can't be used; the message names it, and what to do."""

    def __init__(self, what: str) -> None:
        super().__init__(f"board.kind: {what}; no stop can be written to it: use the POWER SWITCH")


def wire(folder: str) -> Wire:
    """The description of that board. Raises OwnBoardError."""
    from failstop.board.wire import Wire

    found = load(folder, "wire", "WIRE")
    if not isinstance(found, Wire):
        raise OwnBoardError(f"WIRE of {folder}/wire.py is no failstop.board.wire.Wire")
    if len(found.stop.writes) != 1:
        raise OwnBoardError(f"the stop of {folder} has {len(found.stop.writes)} writes; one can be driven")
    return found


def load(folder: str, name: str, value: str) -> Any:
    """A value of a module of that folder. Raises OwnBoardError."""
    _check(folder)
    path = os.path.join(folder, f"{name}.py")
    try:
        module = __import__(f"{_package(folder).__name__}.{name}", fromlist=[value])
    except Exception as error:
        raise OwnBoardError(f"{path}: {type(error).__name__}: {error}") from error
    found = getattr(module, value, None)
    if found is None:
        raise OwnBoardError(f"{path} has no {value}")
    return found


def _package(folder: str) -> ModuleType:
    """The folder as a package. A process has one such board."""
    known = sys.modules.get(OWN_PACKAGE)
    if known is None or list(known.__path__) != [folder]:
        for name in [name for name in sys.modules if name.partition(".")[0] == OWN_PACKAGE]:
            del sys.modules[name]
        known = sys.modules[OWN_PACKAGE] = type(sys)(OWN_PACKAGE)
        known.__path__ = [folder]
    return known


def _check(folder: str) -> None:
    """Refuse what another user may change: the folder's files, and every place on the way to them, links too."""
    try:
        files = [os.path.join(folder, name) for name in os.listdir(folder)]
    except OSError as error:
        raise OwnBoardError(f"{folder}: {error.strerror}") from None
    seen: set[str] = set()
    for path in (folder, *files):
        for here in {path, os.path.realpath(path)}:
            while here not in seen:
                seen.add(here)
                _check_one(here)
                here = os.path.dirname(here)


def _check_one(path: str) -> None:
    try:
        found = os.stat(path)
    except OSError as error:
        raise OwnBoardError(f"{path}: {error.strerror}") from None
    if found.st_uid not in (0, os.geteuid()):
        raise OwnBoardError(f"{path} belongs to another user: sudo chown root {path}")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not found.st_mode & stat.S_ISVTX:
        raise OwnBoardError(f"others may write {path}: sudo chmod go-w {path}")

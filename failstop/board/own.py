"""Own: a board that a folder of the user's describes, by a module wire.py with a Wire named WIRE. A line of it says for
which vocabulary it was written; it is read before the module is run.

Its modules import each other with a dot (`from . import codec`) and failstop's as any program does. They run in every
process of the service, so whoever may write them may drive: the folder and everything above it belongs to root or to
the service's user, and nobody else may write there.
"""

from __future__ import annotations

import os
import stat
import sys

from failstop.data import Data
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from failstop.board.wire import Wire

OWN_PACKAGE = "failstop_own_board"
"""The name under which Python knows it."""
SAYS = "VOCABULARY = "
"""The begin of the line of its wire.py that says for which vocabulary it was written."""
CHECKED_TYPES = ("int", "bool", "str", "float", "bytes")
"""Types of which a field is checked; a whole number is a float too."""


class OwnBoardError(ValueError):
    """The folder can't be used; the message names it, and what to do."""

    def __init__(self, what: str) -> None:
        super().__init__(f"board.kind: {what}; no stop can be written to it: use the POWER SWITCH")


def wire(folder: str) -> Wire:
    """The description of that board. Raises OwnBoardError."""
    from failstop.board.wire import VOCABULARY, Wire

    _check_vocabulary(folder, str(VOCABULARY))
    found = load(folder, "wire", "WIRE")
    if not isinstance(found, Wire):
        raise OwnBoardError(f"WIRE of {folder}/wire.py is no failstop.board.wire.Wire")
    if wrong := _wrong(found, "WIRE"):
        raise OwnBoardError(f"{folder}/wire.py: {wrong}")
    if len(found.stop.writes) != 1:
        raise OwnBoardError(f"the stop of {folder} has {len(found.stop.writes)} writes; one can be driven")
    return found


def _check_vocabulary(folder: str, offered: str) -> None:
    """Refuse a description in another vocabulary. Raises OwnBoardError."""
    _check(folder)
    path = os.path.join(folder, "wire.py")
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            said = [line[len(SAYS) :].partition("#")[0].strip() for line in file if line.startswith(SAYS)]
    except OSError:
        return  # to run it fails likewise, and tells
    if said != [offered]:
        written = f"was written for vocabulary {said[0]}" if said else f"has no line {SAYS}{offered}"
        offers = f"failstop {VERSION} offers vocabulary {offered} of failstop/board/wire.py"
        raise OwnBoardError(f'{path} {written}, and {offers}: docs/dev/porting.md, "Versions"')


def _wrong(value: object, name: str) -> str:
    """The first field, of a description or of one within it, that is absent, unknown or of another type; or empty."""
    if isinstance(value, tuple):
        return next(filter(None, (_wrong(each, f"{name}[{at}]") for at, each in enumerate(value))), "")
    if not isinstance(value, Data):
        return ""
    fields = type(value).__annotations__
    for field in vars(value):
        if field not in fields:
            return f"{name}.{field}: {type(value).__name__} has no such field"
    for field, annotation in fields.items():
        if not hasattr(value, field):
            return f"{name}.{field} is missing"
        found = getattr(value, field)
        kind = type(found).__name__
        if annotation in CHECKED_TYPES and kind != annotation and (kind, annotation) != ("int", "float"):
            return f"{name}.{field} = {found!r}, must be of type {annotation}"
        if wrong := _wrong(found, f"{name}.{field}"):
            return wrong
    return ""


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

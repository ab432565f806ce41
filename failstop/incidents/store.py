"""Store: where incidents are, how many are kept, and which one a person means."""

from __future__ import annotations

import contextlib
import os

from failstop.incidents.file import SUFFIX, IncidentError, read_head
from failstop.procs.telemetry.state_files import SYSTEM_BASE, state_directory
from failstop.shm import root

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from failstop.incidents.incident import Incident

FOLDER = "incidents"
LAST = "last"
MOST_NAMED = 4


def _home(environ: Mapping[str, str]) -> str:
    return os.path.join(environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state"), "failstop")


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """Every folder in which a service of this name may have kept incidents: as one that was started from here, and as
    one of the system's, that systemd gave its state directory."""
    without = {key: value for key, value in environ.items() if key != "STATE_DIRECTORY"}
    base = root.at(SYSTEM_BASE)
    places = [state_directory(name, environ), state_directory(name, without), os.path.join(base, name), base]
    places.append(os.path.join(_home(environ), name))
    return [path for place in dict.fromkeys(places) if os.path.isdir(path := os.path.join(place, FOLDER))]


def _identity(path: str) -> str:
    return os.path.basename(path).removesuffix(SUFFIX)


def _heads(folder: str, name: str) -> tuple[list[dict[str, Any]], list[str]]:
    """As heads(), of one folder, in no order. Raises OSError when it can't be read."""
    found, problems = [], []
    for entry in sorted(os.listdir(folder)):
        path = os.path.join(folder, entry)
        if entry.endswith(SUFFIX):
            try:
                head = read_head(path)
            except IncidentError as error:
                problems.append(str(error))
            else:
                if head.get("name") == name:
                    found.append({**head, "id": _identity(path), "path": path})
    return found, problems


def heads(name: str, environ: Mapping[str, str]) -> tuple[list[dict[str, Any]], list[str]]:
    """The heads of a service's incidents, the oldest first, each with its `id` and `path`; and what is wrong with files
    that can't be read."""
    found: list[dict[str, Any]] = []
    problems = []
    for folder in folders(name, environ):
        try:
            there, damaged = _heads(folder, name)
        except OSError as error:
            problems.append(f"{folder} can't be read: {error.strerror}")
        else:
            found += there
            problems += damaged
    return sorted(found, key=lambda head: float(head.get("t", 0.0))), problems


def prune(folder: str, name: str, keep: int, most_bytes: int) -> list[str]:
    """Remove the oldest incidents of an instance (several may share a folder) beyond `keep` and `most_bytes` together,
    but the newest; returns the file names that were removed. What is no incident is left alone. Raises OSError when
    the folder can't be read."""
    # By the time of saving: an old run's incident is saved after newer ones of nobody.
    newest_first = sorted(_heads(folder, name)[0], key=lambda head: -float(head.get("saved", 0.0)))
    removed, total = [], 0
    for index, path in enumerate(head["path"] for head in newest_first):
        with contextlib.suppress(OSError):
            size = os.stat(path).st_size
            if index and (index >= keep or total + size > most_bytes):
                os.unlink(path)
                removed.append(os.path.basename(path))
            else:
                total += size
    return removed


def identities(environ: Mapping[str, str]) -> list[str]:
    """The ids of all incidents on this machine, whatever service they are of; as far as this user may look."""
    from glob import glob

    places = [os.path.join(base, deep) for base in (root.at(SYSTEM_BASE), _home(environ)) for deep in ("", "*")]
    return sorted(_identity(path) for place in places for path in glob(os.path.join(place, FOLDER, "*" + SUFFIX)))


def load(wanted: str, name: str, environ: Mapping[str, str]) -> Incident:
    """The incident that is meant: a path, `last`, an id or the beginning of one. Raises IncidentError."""
    from failstop.incidents.incident import Incident

    return Incident.read(wanted if os.sep in wanted or wanted.endswith(SUFFIX) else _path(wanted, name, environ))


def _path(wanted: str, name: str, environ: Mapping[str, str]) -> str:
    found, problems = heads(name, environ)
    meant = [head for head in found if head["id"] == wanted]
    meant = meant or (found[-1:] if wanted == LAST else [head for head in found if head["id"].startswith(wanted)])
    if len(meant) == 1:
        return str(meant[0]["path"])
    if meant:
        newest = ", ".join(head["id"] for head in meant[-MOST_NAMED:])
        more = f" and {len(meant) - MOST_NAMED} older ones" if len(meant) > MOST_NAMED else ""
        raise IncidentError(f"incident {wanted!r} may be {newest}{more}: write more of it")
    # A damaged file is not in the list; whoever names it should be told why.
    for folder in folders(name, environ):
        if os.path.exists(path := os.path.join(folder, wanted + SUFFIX)):
            return path
    if not found:
        places = ", ".join(folders(name, environ)) or "no folder for them"
        more = f"; {problems[0]}" if problems else ""
        raise IncidentError(f"no incidents of {name!r} ({places}): nothing was latched yet, or see --name{more}")
    raise IncidentError(f"no incident {wanted!r} of {name!r}: `failstop incident list` shows them")

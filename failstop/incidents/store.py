"""Store: where incidents are, and which one a person means."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from glob import glob
from typing import Any

from failstop.incidents.file import SUFFIX, IncidentError, read_head
from failstop.incidents.incident import Incident
from failstop.incidents.saver import FOLDER
from failstop.procs.telemetry.state_files import SYSTEM_BASE, state_directory
from failstop.shm import root

LAST = "last"
MOST_NAMED = 4


def folders(name: str, environ: Mapping[str, str]) -> list[str]:
    """Every folder in which a service of this name may have kept incidents: as one that was started from here, and as
    one of the system's, that systemd gave its state directory."""
    without = {key: value for key, value in environ.items() if key != "STATE_DIRECTORY"}
    home = environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    base = root.at(SYSTEM_BASE)
    places = [
        state_directory(name, environ),
        state_directory(name, without),
        os.path.join(base, name),
        base,
        os.path.join(home, "failstop", name),
    ]
    return [path for place in dict.fromkeys(places) if os.path.isdir(path := os.path.join(place, FOLDER))]


def heads(name: str, environ: Mapping[str, str]) -> tuple[list[dict[str, Any]], list[str]]:
    """The heads of a service's incidents, the oldest first, each with its `id` and `path`; and what is wrong with files
    that can't be read."""
    found: list[dict[str, Any]] = []
    problems = []
    for folder in folders(name, environ):
        try:
            entries = sorted(os.listdir(folder))
        except OSError as error:
            problems.append(f"{folder} can't be read: {error.strerror}")
            continue
        for entry in entries:
            path = os.path.join(folder, entry)
            if entry.endswith(SUFFIX):
                try:
                    head = read_head(path)
                except IncidentError as error:
                    problems.append(str(error))
                    continue
                if head.get("name") == name:
                    found.append({**head, "id": entry.removesuffix(SUFFIX), "path": path})
    return sorted(found, key=lambda head: float(head.get("t", 0.0))), problems


def identities(environ: Mapping[str, str]) -> list[str]:
    """The ids of all incidents on this machine, whatever service they are of; as far as this user may look."""
    home = environ.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    bases = (root.at(SYSTEM_BASE), os.path.join(home, "failstop"))
    found = [
        path for base in bases for deep in ("", "*") for path in glob(os.path.join(base, deep, FOLDER, "*" + SUFFIX))
    ]
    return sorted(os.path.basename(path).removesuffix(SUFFIX) for path in found)


def load(wanted: str, name: str, environ: Mapping[str, str]) -> Incident:
    """The incident that is meant: a path, `last`, an id or the beginning of one. Raises IncidentError."""
    if os.sep in wanted or wanted.endswith(SUFFIX):
        return Incident.read(wanted)
    found, problems = heads(name, environ)
    if wanted == LAST and found:
        return Incident.read(found[-1]["path"])
    meant = [head for head in found if head["id"] == wanted] or [
        head for head in found if head["id"].startswith(wanted) and wanted != LAST
    ]
    if len(meant) == 1:
        return Incident.read(meant[0]["path"])
    if meant:
        newest = [head["id"] for head in meant[-MOST_NAMED:]]
        more = f" and {len(meant) - len(newest)} older ones" if len(meant) > len(newest) else ""
        raise IncidentError(f"incident {wanted!r} may be {', '.join(newest)}{more}: write more of it")
    # A damaged file is not in the list; whoever names it should be told why.
    for folder in folders(name, environ):
        path = os.path.join(folder, wanted + SUFFIX)
        with contextlib.suppress(OSError):
            if os.stat(path):
                return Incident.read(path)
    if not found:
        places = ", ".join(folders(name, environ)) or "no folder for them"
        more = f"; {problems[0]}" if problems else ""
        raise IncidentError(f"no incidents of {name!r} ({places}): nothing was latched yet, or see --name{more}")
    raise IncidentError(f"no incident {wanted!r} of {name!r}: `failstop incident list` shows them")

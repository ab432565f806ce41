"""Leftovers: cleans up after killed services that had one-time names, such as `setup-4711`.

A service that is started again removes what its last run has left behind, but nobody starts `setup-4711` again. Call
remove_ended() before you start a service with a one-time name. This function removes what such services have left
behind: shared memory, the runtime folder, and the folder that folder() has made.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile

from failstop import instances
from failstop.files import instance
from failstop.messages import segments


def folder(name: str) -> str:
    """Make a folder for the files of the service `name`, and return its path. The folder's name contains `name`, so
    that remove_ended() can find it. Raises OSError."""
    return tempfile.mkdtemp(prefix=f"{_folders_of(name)}")


def remove(name: str) -> None:
    """Remove the shared memory and the runtime folder of a service. Call it after the service has ended."""
    for run in segments.dead_runs(name):
        segments.unlink_all(run)
    for path in instance.places(name):
        shutil.rmtree(path, ignore_errors=True)


def remove_ended(prefix: str) -> None:
    """Remove what this user's ended services have left behind, if their names consist of `prefix` and a process id, for
    example `setup-4711`. A service is left alone while the service or the process with this id is running."""
    names = {name.removeprefix("failstop.").partition(".")[0] for name in _listed(segments.SHM, "failstop.")}
    for base in instance.bases():
        names.update(_listed(base, prefix))
    whole = _folders_of(prefix)
    folders = _listed(tempfile.gettempdir(), whole)
    names.update(prefix + found.removeprefix(whole).partition(".")[0] for found in folders)
    for name in names:
        pid = name.removeprefix(prefix)
        if not (name.startswith(prefix) and pid.isdecimal()) or os.path.exists(f"/proc/{pid}"):
            continue
        paths = [path for path in instance.places(name) if os.path.exists(path)]
        # A process in a container has another PID here, so check whether the service is running, too.
        if any(_is_another_s(path) or instances.running(path) or instances.holder(path) for path in paths):
            continue
        remove(name)
        for found in folders:
            path = os.path.join(tempfile.gettempdir(), found)
            if found.startswith(_folders_of(name)) and not _is_another_s(path):
                shutil.rmtree(path, ignore_errors=True)


def _folders_of(name: str) -> str:
    # The dot marks the end of the name. Without the dot, setup-12 would match the folders of setup-123 too.
    return f"failstop-{name}." if name[-1:].isdecimal() else f"failstop-{name}"


def _listed(folder: str, prefix: str) -> list[str]:
    with contextlib.suppress(OSError):
        return [name for name in os.listdir(folder) if name.startswith(prefix)]
    return []


def _is_another_s(path: str) -> bool:
    try:
        return os.lstat(path).st_uid != os.geteuid()
    except OSError:
        return True

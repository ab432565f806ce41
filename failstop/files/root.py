"""Root: the root directory below which failstop finds the system directories, and the directory in which an instance
keeps its files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

SYSTEM_BASE = "/var/lib/failstop"
VARIABLE = "FAILSTOP_ROOT"
"""The environment variable that names another root directory than /. A service below it has nothing to do with what is
installed or running on the machine."""


def at(path: str) -> str:
    """The path below the root directory ($FAILSTOP_ROOT) for an absolute system path such as /run/failstop."""
    return os.environ.get(VARIABLE, "") + path


def _by_this_process(path: str) -> bool:
    return os.access(path, os.W_OK | os.X_OK)


def state_directory(
    instance: str,
    environ: Mapping[str, str],
    configured: str = "",
    writable: Callable[[str], bool] = _by_this_process,
) -> str:
    """The directory in which an instance keeps its files after it ends, such as incidents. It may not exist yet.

    The first of these is used: `configured`, systemd's $STATE_DIRECTORY, /var/lib/failstop/NAME if it is writable,
    failstop/NAME in $XDG_STATE_HOME or ~/.local/state. `writable`: returns True if the user may write to a folder.
    """
    if configured:
        return configured
    if given := environ.get("STATE_DIRECTORY", "").split(":")[0]:
        return given
    base = at(SYSTEM_BASE)
    system = os.path.join(base, instance)
    if writable(system if os.path.exists(system) else base):
        return system
    home = environ.get("XDG_STATE_HOME") or os.path.join(environ.get("HOME") or os.path.expanduser("~"), ".local/state")
    return os.path.join(home, "failstop", instance)

"""Root: the directory below which this process finds the machine's own directories, and an instance's directory that
outlives it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

SYSTEM_BASE = "/var/lib/failstop"
VARIABLE = "FAILSTOP_ROOT"
"""Names another root than /, so that a run below it has nothing to do with what is installed, or running, on the
machine."""


def at(path: str) -> str:
    """The place of an absolute system path, such as /run/failstop, below the root."""
    return os.environ.get(VARIABLE, "") + path


def _by_this_process(path: str) -> bool:
    return os.access(path, os.W_OK | os.X_OK)


def state_directory(
    instance: str,
    environ: Mapping[str, str],
    configured: str = "",
    writable: Callable[[str], bool] = _by_this_process,
) -> str:
    """The directory for an instance's files, which may not exist yet: the configured one; systemd's $STATE_DIRECTORY;
    /var/lib/failstop/NAME if that is writable; else under $XDG_STATE_HOME or ~/.local/state. `writable`: whether the
    user whose directory it is may write to a folder."""
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

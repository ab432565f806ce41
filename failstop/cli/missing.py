"""Missing: prints which Python package can't be imported, and how to install it. It imports no other module of
failstop, because that might fail too."""

from __future__ import annotations

import sys

INCOMPLETE = 78
"""The exit code if a package is missing (EX_CONFIG of sysexits.h). A restart would not help, so the ROS 2 bridge's
systemd unit and launch file don't restart the bridge after this code."""
DISTRIBUTIONS = {
    "msgpack": ("msgpack", "python3-msgpack"),
    "numpy": ("numpy", "python3-numpy"),
    "posix_ipc": ("posix-ipc", ""),
    "psutil": ("psutil", "python3-psutil"),
    "serial": ("pyserial", "python3-serial"),
    "tomli": ("tomli", "python3-tomli"),
}
"""The modules that failstop needs. For each, its package on PyPI, and the Debian package that has it for the system's
Python (empty if there is none)."""


def text(error: ImportError) -> str:
    """Describe which package is missing, for which Python, and how to install it. Empty if one of failstop's own
    modules is missing, because that is a bug."""
    module = (error.name or "").partition(".")[0]
    if module == "failstop":
        return ""
    python = f"Python {sys.version_info[0]}.{sys.version_info[1]} ({sys.executable})"
    remedy = f"install what it needs for {python}"
    if known := DISTRIBUTIONS.get(module):
        pip, debian = known
        system = debian and sys.executable.startswith("/usr/bin/")
        remedy = f"next: `{f'sudo apt install {debian}' if system else f'{sys.executable} -m pip install {pip}'}`"
    return f"{python} can't import {module or 'a module'} ({error}); {remedy}"


def say(error: ImportError) -> int:
    """Print the missing package, and return the exit code. Raises the error again if one of failstop's own modules is
    missing."""
    if not (line := text(error)):
        raise error
    sys.stderr.write(f"failstop: {line}\n")
    return INCOMPLETE

"""Missing: prints in one line which package this Python can't import. It imports nothing else of failstop, because that
might fail too."""

from __future__ import annotations

import sys

INCOMPLETE = 78
"""The exit code if a package is missing (EX_CONFIG of sysexits.h). A restart can't help, so neither the systemd unit of
the ROS 2 bridge nor its launch file restarts it then."""
DISTRIBUTIONS = {
    "msgpack": ("msgpack", "python3-msgpack"),
    "numpy": ("numpy", "python3-numpy"),
    "posix_ipc": ("posix-ipc", ""),
    "psutil": ("psutil", "python3-psutil"),
    "serial": ("pyserial", "python3-serial"),
    "tomli": ("tomli", "python3-tomli"),
}
"""The modules that failstop needs, each with its name on PyPI and the Debian package for the system's Python."""


def text(error: ImportError) -> str:
    """What is missing, for which Python, and the remedy; empty for a module of failstop itself, which is a defect."""
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
    """Print what is missing, and return the exit code. Raises the error again if it is a defect of failstop."""
    if not (line := text(error)):
        raise error
    sys.stderr.write(f"failstop: {line}\n")
    return INCOMPLETE

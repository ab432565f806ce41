"""Missing: a package that this Python can't import, in one line. It imports nothing else of failstop, because that may
fail too."""

from __future__ import annotations

import sys

INCOMPLETE = 78
"""The exit code (EX_CONFIG of sysexits.h): to start it again can't help, so neither the unit of the bridge to ROS 2 nor
its launch file does."""
DISTRIBUTIONS = {
    "msgpack": ("msgpack", "python3-msgpack"),
    "numpy": ("numpy", "python3-numpy"),
    "posix_ipc": ("posix-ipc", ""),
    "psutil": ("psutil", "python3-psutil"),
    "serial": ("pyserial", "python3-serial"),
    "tomli": ("tomli", "python3-tomli"),
}
"""Modules that failstop needs, each with its name in PyPI and the Debian package for the system's Python."""


def text(error: ImportError) -> str:
    """What is missing, where, and the remedy; empty for a module of failstop's own, which is a defect."""
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
    """Print what is missing; returns the exit code. Raises the error again if it is a defect of failstop's."""
    if not (line := text(error)):
        raise error
    sys.stderr.write(f"failstop: {line}\n")
    return INCOMPLETE

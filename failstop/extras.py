"""Extras: the packages that only some parts of failstop need, and the message for a user who lacks them.

No package index has failstop itself, so an extra of failstop can't be installed by its name. The message therefore
names the packages themselves, and the Python for which they must be installed.
"""

from __future__ import annotations

import importlib.util
import shlex
import sys

PACKAGES = {
    "export": ("mcap", "mcap-ros2-support"),
    "fleet": ("paho-mqtt", "prometheus-client"),
    "plots": ("matplotlib",),
    "web": ("segno", "tornado"),
}
"""The packages of each extra. The extras have the same names in pyproject.toml."""


def missing(what: str, extra: str, *, pip: bool | None = None) -> str:
    """The message if the packages of an extra are missing: what needs them, and the pip command that installs them.
    `pip`: True if this Python has pip, False if it has none; by default this function looks for it."""
    packages = " ".join(PACKAGES[extra])
    if not (importlib.util.find_spec("pip") if pip is None else pip):
        return f"{what}, and there is no pip in {sys.prefix}: do it on a machine with failstop's source and {packages}"
    return f"{what}: {shlex.quote(sys.executable)} -m pip install {packages}"

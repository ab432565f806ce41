"""Extras: the packages that only some parts of failstop need, and the message for a user who lacks them.

failstop is on no package index, so an extra can't be installed by its name. The message names the packages, and the
Python that needs them.
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
    """The message for a user who lacks the packages of an extra, with the pip command that installs them. The message
    begins with `what`. `pip`: True if this Python has pip, False if not. By default, this function looks for pip."""
    packages = " ".join(PACKAGES[extra])
    if not (importlib.util.find_spec("pip") if pip is None else pip):
        return f"{what}, and there is no pip in {sys.prefix}: do it on a machine with failstop's source and {packages}"
    return f"{what}: {shlex.quote(sys.executable)} -m pip install {packages}"

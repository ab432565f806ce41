"""Extras: packages that a part of failstop needs and the service does not, and what to type where they are missing.

No index has failstop itself: a person is told the packages by their own names, for the environment that runs this.
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
"""By the extra of pyproject.toml that names them."""


def missing(what: str, extra: str, *, pip: bool | None = None) -> str:
    """The message for something that needs an extra which is not there. `pip`: there is one here; None: look."""
    packages = " ".join(PACKAGES[extra])
    if not (importlib.util.find_spec("pip") if pip is None else pip):
        return f"{what}, and there is no pip in {sys.prefix}: do it on a machine with failstop's source and {packages}"
    return f"{what}: {shlex.quote(sys.executable)} -m pip install {packages}"

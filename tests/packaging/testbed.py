"""autopkgtest's view of a container that runs already: `autopkgtest ... -- PYTHON testbed.py ROOT COMMAND...`.

COMMAND enters the container as root, and ROOT is its root as it is seen from out here. autopkgtest has a server of its
own for a system that is there, `null`. But newer ones say that it isolates nothing, so autopkgtest skips each test that
needs a container. This one says what is true of bench/container.py. Its hooks are what autopkgtest's library calls
(README.virtualisation-server).
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

LIBRARY = "/usr/share/autopkgtest/lib"
"""Where autopkgtest keeps the module that speaks its protocol."""
CAPABILITIES = ("isolation-container", "root-on-testbed")
"""In its words: tests may start and stop services, and run as root."""
SHARED = "downtmp-host="
"""Before the path out here of the folder that both sides see."""

root, command = sys.argv[1], sys.argv[2:]
protocol: Any = None
capabilities = list(CAPABILITIES)


def hook_open() -> None:
    """The container is there: say how a command gets into it."""
    protocol.auxverb = command


def hook_downtmp(path: str | None) -> str:
    """A folder inside for what is copied; `path`: the same again."""
    inside: str = protocol.downtmp_mktemp(path)
    capabilities[:] = [*CAPABILITIES, f"{SHARED}{root}{inside}"]
    return inside


def hook_cleanup() -> None:
    """Take the folder away."""
    protocol.downtmp_remove()
    capabilities[:] = CAPABILITIES


def hook_capabilities() -> list[str]:
    """What this container can."""
    return list(capabilities)


if __name__ == "__main__":
    sys.path.insert(0, LIBRARY)
    protocol = importlib.import_module("VirtSubproc")
    protocol.main()

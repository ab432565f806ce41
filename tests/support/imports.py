"""Imports of a module, asked of a process that makes them, and those that no process of the service may make."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import failstop

FORBIDDEN = frozenset(
    (
        *("argparse", "asyncio", "dataclasses", "inspect", "json", "logging", "numpy", "pathlib", "psutil", "re"),
        *("serial", "subprocess", "typing"),
    )
)
_LIST = """
import os, sys
sys.path[:] = os.environ["FAILSTOP_PATH"].split(os.pathsep)
__import__(sys.argv[1])
sys.stdout.write("\\n".join(sys.modules))
"""


def imported(module: str) -> set[str]:
    """Names of the top-level modules in a process that imports this one as supervisor/bootstrap.py does."""
    root = str(Path(failstop.__file__).resolve().parent.parent)
    path = os.pathsep.join(dict.fromkeys([root, *(entry for entry in sys.path if os.path.isabs(entry))]))
    arguments = [sys.executable, "-I", "-S", "-c", _LIST, module]
    done = subprocess.run(arguments, env={"FAILSTOP_PATH": path}, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    found = set(done.stdout.splitlines())
    assert module in found
    return {name.partition(".")[0] for name in found}

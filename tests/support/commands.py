"""The command line as its user calls it: a process of its own, and what it prints."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

FAILSTOP = (sys.executable, "-m", "failstop")


def script(path: Path) -> ModuleType:
    """A program of this repository that is in no package, as a module; it leaves no compiled copy beside itself."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


def failstop(*words: str, said: str | None = None, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Run `failstop WORDS` to its end; `said`: what is typed. Raises subprocess.TimeoutExpired."""
    command = [*FAILSTOP, *words]
    return subprocess.run(command, input=said, capture_output=True, text=True, timeout=timeout, check=False)

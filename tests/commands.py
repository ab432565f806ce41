"""The command line as its user calls it: a process of its own, and what it prints."""

from __future__ import annotations

import subprocess
import sys

FAILSTOP = (sys.executable, "-m", "failstop")


def failstop(*words: str, said: str | None = None, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Run `failstop WORDS` to its end; `said`: what is typed. Raises subprocess.TimeoutExpired."""
    command = [*FAILSTOP, *words]
    return subprocess.run(command, input=said, capture_output=True, text=True, timeout=timeout, check=False)

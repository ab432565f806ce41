"""The programs of the running system that an installation uses."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Sequence

from failstop.install import InstallError
from failstop.install.rows import EXTRAS

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
RUN_S = 60.0
READY_S = 20.0
POLL_S = 0.05


class Machine:
    """Runs them; `ready_s` is how long a unit has to become ready."""

    def __init__(self, ready_s: float = READY_S) -> None:
        self._ready_s = ready_s

    def run(self, words: Sequence[str], accepted: Sequence[int] = (0,)) -> None:
        """Run a program to its end. Raises InstallError with what it said."""
        result = _call(words)
        if result.returncode not in accepted:
            said = " ".join((result.stderr or result.stdout).split()) or f"exit code {result.returncode}"
            raise InstallError(f"{' '.join(words)}: {said}")

    def start(self, unit: str) -> None:
        """Start a unit and wait until it says that it is ready. Raises InstallError with what it waits for."""
        since_s = time.time()
        self.run(("systemctl", "reset-failed", unit), accepted=(0, 1))
        self.run(("systemctl", "start", "--no-block", unit))
        until_s = time.monotonic() + self._ready_s
        while True:
            state = show(unit)
            if state["ActiveState"] == "active" and state["SubState"] == "running":
                return
            if state["ActiveState"] == "failed" or time.monotonic() > until_s:
                why = "failed" if state["ActiveState"] == "failed" else f"is not ready after {self._ready_s:g} s"
                says = state["StatusText"] or _first_words(unit, since_s) or state["Result"]
                raise InstallError(f"{unit} {why} and says: {says}; `journalctl -u {unit}` tells more")
            time.sleep(POLL_S)


def _first_words(unit: str, since_s: float) -> str:
    """The first line of a unit's own since then, in wall time."""
    words = ("journalctl", "--quiet", "--no-pager", "--output=cat", "-u", unit, "-t", "failstop")
    return next(iter(_call((*words, f"--since=@{since_s:.3f}")).stdout.splitlines()), "").removeprefix("failstop: ")


def show(unit: str) -> dict[str, str]:
    """State, and what it says of itself."""
    keys = ("ActiveState", "SubState", "StatusText", "Result")
    result = _call(("systemctl", "show", "-p", ",".join(keys), unit))
    return dict.fromkeys(keys, "") | dict(line.split("=", 1) for line in result.stdout.splitlines() if "=" in line)


def active_units() -> tuple[str, ...]:
    """The units of failstop that run, or are about to."""
    states = "--state=active,activating,reloading"
    patterns = ("failstop.service", "failstop@*.service", *(extra.source for extra in EXTRAS))
    result = _call(("systemctl", "list-units", states, "--plain", "--no-legend", *patterns))
    return tuple(line.split()[0] for line in result.stdout.splitlines() if line.strip())


def _call(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": PATH, "LC_ALL": "C.UTF-8"}
    try:
        return subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=RUN_S, check=False, env=environment
        )
    except FileNotFoundError:
        raise InstallError(f"{words[0]} is not on this machine: install the package that has it") from None
    except subprocess.TimeoutExpired:
        raise InstallError(f"{' '.join(words)} did not end within {RUN_S:g} s") from None

"""The demo is a promise of the README: it runs, it is quick, it says what it saw."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable

from failstop.shm import layout


def test_demo(failstop: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    start_s = time.monotonic()
    result = failstop("demo", timeout=60)
    assert result.returncode == 0, result.stdout + result.stderr
    assert time.monotonic() - start_s < 40
    for process in layout.PROCESSES:
        assert f"kill -9 {process} " in result.stdout
    assert "nothing moved again" in result.stdout

"""The demo is a promise of the README: it runs, it is quick, it says what it saw."""

from __future__ import annotations

import time

from failstop.shm import layout
from tests.support.commands import failstop


def test_demo() -> None:
    start_s = time.monotonic()
    result = failstop("demo", timeout=60)
    assert result.returncode == 0, result.stdout + result.stderr
    assert time.monotonic() - start_s < 40
    for process in layout.PROCESSES:
        assert f"kill -9 {process} " in result.stdout
    assert "nothing moved again" in result.stdout

"""Waiting for a condition instead of for a time."""

from __future__ import annotations

import select
import time
from collections.abc import Callable

import pytest

DEADLINE_S = 20.0
STORY_S = 200.0
"""The operator's page makes stories and pictures with `nice -n 10`, and the other tests that run meanwhile are not so
polite."""


def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; fails after the deadline."""
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > end_s:
            pytest.fail(f"not within {DEADLINE_S} s: {what}")
        select.select([], [], [], 0.0005)

"""Folders of a machine on which setup is tried."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder with short paths."""
    with tempfile.TemporaryDirectory(prefix="s", dir="/tmp") as folder:
        for made in ("etc/failstop", "run/failstop", "var/lib/failstop"):
            (Path(folder) / made).mkdir(parents=True)
        yield Path(folder)

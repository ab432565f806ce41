"""Every input that a fuzzer has found to fail, and every example, is taken."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.targets import TARGETS

FOUND = Path(__file__).resolve().parent / "found"


@pytest.mark.parametrize("name", TARGETS)
def test_what_has_failed_once_and_every_example(name: str) -> None:
    for data in (*TARGETS[name].examples, b"", *(path.read_bytes() for path in sorted(FOUND.glob(f"{name}-*")))):
        TARGETS[name].run(data)

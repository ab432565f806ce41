"""The page that the table stands in."""

from __future__ import annotations

from pathlib import Path

from tests.safety import table

PAGE = Path(__file__).parents[2] / "docs" / "safety.md"
BEGIN = "<!-- of tests/safety/table.py: `python -m tests.safety` -->"


def renewed() -> str:
    """The page with the table of now."""
    before, begin, rest = PAGE.read_text(encoding="utf-8").partition(f"{BEGIN}\n")
    assert begin, BEGIN
    after = rest.splitlines()
    while after and after[0].startswith("|"):
        after.pop(0)
    return "\n".join([before + BEGIN, *table.lines(), *after]) + "\n"

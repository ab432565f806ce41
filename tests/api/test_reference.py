"""The reference is what the docstrings say, and leaves nothing out."""

from __future__ import annotations

from pathlib import Path

import failstop
from failstop_lab.pages import reference

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/reference/python.md"


def test_the_page_is_that_of_the_docstrings() -> None:
    assert PAGE.read_text() == reference.page(), "renew it: make docs"


def test_every_public_name_is_on_it_and_every_row_says_something() -> None:
    lines = PAGE.read_text().splitlines()
    for name in set(failstop.__all__) - {"__version__", "Answer"}:
        assert any(line.startswith(f"### {name}") for line in lines), name
    rows = [line for line in lines if line.startswith("| `")]
    assert len(rows) > 100
    assert not [row for row in rows if row.endswith("` |  |")]

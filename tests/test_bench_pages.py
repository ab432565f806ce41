"""The tables of the pages are taken from a run, and only whole."""

from __future__ import annotations

from typing import Any

import pytest

from bench import pages

ROWS: list[dict[str, Any]] = [
    {"measure": "kill gate -> stop frame", "result": "p50 0.40 ms", "bar": "p99 < 2 ms", "met": True},
    {"measure": "one way", "result": "20 us (2 x floor)", "bar": "10 us", "met": False},
    {"measure": "floor", "result": "0.9 ms", "bar": "-", "met": None},
]
PAGE = "before\n\n| measure | measured | bar | |\n|---|---|---|---|\n| one way | old | old | met |\n\nafter | that\n"
SHOWN = PAGE.replace("| bar |", "| promised |")
"""For users, of whom nobody knows what the floor is."""


def test_the_readme_keeps_its_choice_of_rows() -> None:
    page = pages.renewed(SHOWN, ROWS, every=False)
    assert page == SHOWN.replace("| old | old | met |", "| 20 us (2 x C) | 10 us | **missed** |")


def test_the_other_page_has_every_row_in_the_run_s_order() -> None:
    page = pages.renewed(PAGE, ROWS, every=True)
    assert [line.split(" | ")[0] for line in page.splitlines()[4:7]] == [f"| {row['measure']}" for row in ROWS]
    assert page.endswith("| floor | 0.9 ms | - |  |\n\nafter | that\n")


def test_a_row_that_was_not_measured_is_an_error() -> None:
    with pytest.raises(KeyError, match="one way"):
        pages.renewed(SHOWN, ROWS[:1], every=False)


@pytest.mark.parametrize(("page", "every"), [("README.md", False), ("docs/dev/measured.md", True)])
def test_the_pages_have_such_a_table(page: str, every: bool) -> None:
    text = (pages.ROOT / page).read_text()
    named = [row for row in text.splitlines() if row.startswith("| ")]
    rows = [
        {"measure": row.split(" | ")[0].removeprefix("| "), "result": "0.40 ms", "bar": "", "met": None}
        for row in named
    ]
    assert pages.renewed(text, rows, every=every).count("0.40 ms") >= 1

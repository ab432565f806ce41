"""The page of causes: what the table says, whole and in a form that every reader of Markdown shows alike."""

from __future__ import annotations

from pathlib import Path

from failstop.policy import causes
from failstop_lab.pages import causes as manual

PAGE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "causes.md"


def test_the_page_is_the_generated_one() -> None:
    assert PAGE.read_text() == manual.page(), "renew it: make docs"


def test_every_cause_has_a_row_with_every_cell_filled() -> None:
    rows = [line.strip("|").split("|") for line in manual.page().splitlines() if line.startswith("| `")]
    assert [row[1].strip(" `") for row in rows] == list(causes.CAUSE_BY_NAME)
    assert [row for row in rows if len(row) != 6 or not all(cell.strip() for cell in row)] == []


def test_no_place_of_an_argument_is_left_open() -> None:
    page = manual.page()
    assert not {"{", "}"} & set(page)
    assert "| `the battery is at N V` |" in page
    assert "| `stop request[: WORDS] (says it is WHO, pid N)` |" in page

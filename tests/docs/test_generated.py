"""Every file that is made from the code is as the code has it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from failstop_lab.pages import made
from failstop_lab.pages.marked import renewed


@pytest.mark.parametrize("name", made.FILES)
def test_a_file_is_the_generated_one(name: str) -> None:
    written = (made.ROOT / name).read_text("utf-8")
    assert written == made.FILES[name](written), "renew it: make docs"


def test_what_was_changed_by_hand_is_found_with_its_text_as_it_should_be(tmp_path: Path) -> None:
    for name in made.FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(made.ROOT / name, tmp_path / name)
    assert made.differing(tmp_path) == {}
    page = tmp_path / "docs/logs.md"
    before = page.read_text()
    page.write_text(before.replace("| `unstill` |", "| `other` |"))
    assert made.differing(tmp_path) == {"docs/logs.md": before}


def test_a_page_without_its_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="no marks of the part 'kinds'"):
        renewed("a page", "kinds", "a table")

"""docs/ros2.md shows the tables that the bridge runs."""

from __future__ import annotations

from pathlib import Path

from failstop.ros2 import page

PAGE = Path(__file__).resolve().parents[2] / "docs" / "ros2.md"


def test_the_page_is_that_of_the_code() -> None:
    written = PAGE.read_text()
    assert page.BEGIN in written
    assert written == page.with_tables(written), "renew it: python -m failstop.ros2.page docs/ros2.md"

"""docs/ros2.md shows the tables that the bridge runs."""

from __future__ import annotations

from failstop.lab.pages import made, ros2

PAGE = made.ROOT / "docs" / "ros2.md"


def test_the_page_is_that_of_the_code() -> None:
    assert ros2.text() in PAGE.read_text(), "renew it: make docs"

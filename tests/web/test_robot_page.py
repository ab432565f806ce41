"""The page with the robot in it, from its file in a real browser: rows of the fault table by clicking. `make web`
builds the page first."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop_lab.browser.acts import ROWS
from tests.support.robot_page import play
from tests.web.browser import CHROMIUM, Browser, Tab

FILE = Path(__file__).parents[2] / "build" / "browser" / "index.html"
pytestmark = [
    pytest.mark.page,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it"),
    pytest.mark.skipif(not FILE.exists(), reason="no page: make browser builds it"),
]
PICTURES = os.environ.get("FAILSTOP_PICTURES", "")
"""The folder for pictures of the page, where somebody wants to look at it."""
PHONE, DESK = (390, 844), (1440, 900)
STARTED_S = 300.0
"""Some seconds of one core, of a machine that others use too."""


class Clicks:
    """The page by its buttons, in a tab of its own: time passes by the step's button alone."""

    def __init__(self, browser: Browser) -> None:
        self.tab: Tab = browser.tab(wide=PHONE[0], high=PHONE[1])
        self.tab.answer_s = STARTED_S
        self.tab.open(FILE.as_uri())
        self.tab.until("globalThis.started_ms", "the service to start", STARTED_S)
        self._click("[data-speed='0']")

    def _click(self, selector: str) -> None:
        """Click, and wait until what it asks for is done."""
        self.tab.run(f"(async () => {{ document.querySelector({json.dumps(selector)}).click(); await asked; }})()")

    def press(self, act: str) -> None:
        self._click(f"[data-act='{act}']")

    def step(self) -> None:
        self._click("#step")

    def shown(self) -> dict[str, Any]:
        """The values that the page draws, and with them that it draws them."""
        shown: dict[str, Any] = self.tab.run("globalThis.shown")
        assert self.tab.text("#word") == shown["view"]["word"]
        assert self.tab.run("[...document.querySelectorAll('#said dd')].map((each) => each.textContent)") == [
            text for _, text in shown["why"]
        ]
        return shown


@pytest.fixture(scope="module")
def page(browser: Browser) -> Iterator[Clicks]:
    found = Clicks(browser)
    yield found
    assert found.tab.errors == []


@pytest.mark.parametrize("name", ROWS)
def test_a_fault_by_clicking_ends_as_its_row_says(page: Clicks, name: str) -> None:
    play(page, name)


@pytest.mark.parametrize(("wide", "high"), [PHONE, DESK])
def test_nothing_is_wider_than_the_screen_and_nothing_is_fetched(page: Clicks, wide: int, high: int) -> None:
    page.tab.size(wide, high, touch=wide < high)
    assert page.tab.run("document.documentElement.scrollWidth") <= wide
    assert page.tab.run("performance.getEntriesByType('resource').length") == 0
    if PICTURES:
        page.tab.picture(Path(PICTURES) / f"robot-{wide}.png")

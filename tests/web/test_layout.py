"""The page's layout in a real browser: STOP on the screen at every size, zoom, text size and in forced colours, and no
word broken. Needs chromium: `make web`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from typing import Any

import pytest

from failstop_lab.trial import Trial
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

SCREENS = [
    (320, 568), (568, 320), (390, 844), (844, 390), (412, 915), (768, 1024), (1024, 768), (1280, 720), (1920, 1080),
]  # fmt: skip
TEXTS = [100, 150, 200, 300]
"""Percent of the browser's text size."""
ZOOMS = [150, 200, 300]
"""Percent by which the browser enlarges everything: the screen is so much smaller to the page."""
FAILED = "NOT WRITTEN (no service named 'failstop' is running). Still trying: use the POWER SWITCH"
"""A long text of a stop that failed."""
WORDS = [
    "STOPPED",
    "WHEELS MAY TURN",
    "NO CONTACT",
    "CONNECTING",
    "STOP WRITTEN",
    "WHEELS TURN",
    "ROBOT MOVES",
    "TOLD TO STOP",
]
LONGEST = 20
"""Characters of a word that is kept whole; a path may be broken."""
LEAST_SHARE = 0.15
"""The part of the screen's height that STOP takes at least."""

SEEN = """
(() => {
  const view = visualViewport, wrong = [], button = document.getElementById("stop");
  const inside = (box, of, what) => {
    const over = [of.left - box.left, of.top - box.top, box.right - of.right, box.bottom - of.bottom];
    if (Math.max(...over) > 0.5) wrong.push(`${what} is ${over.map(Math.round)} px outside (left, top, right, bottom)`);
  };
  const screen = {left: view.offsetLeft, top: view.offsetTop,
    right: view.offsetLeft + view.width, bottom: view.offsetTop + view.height};
  const box = button.getBoundingClientRect();
  inside(box, screen, "STOP");
  if (box.height < LEAST * view.height) wrong.push(`STOP is ${Math.round(box.height)} of ${view.height} px high`);
  for (const id of ["stop-word", "stop-said"]) {
    const text = document.createRange(), {top, bottom} = document.getElementById(id).getBoundingClientRect();
    text.selectNodeContents(document.getElementById(id));
    const {left, right} = text.getBoundingClientRect(); // its height is that of the font, which is more than it draws
    inside({left, right, top, bottom}, box, id);
  }
  for (const [x, y] of [[.5, .5], [.1, .2], [.9, .2], [.1, .8], [.9, .8]]) {
    const there = document.elementFromPoint(box.left + x * box.width, box.top + y * box.height);
    if (!button.contains(there)) wrong.push(`${there && there.id} lies over STOP`);
  }
  const word = document.createRange();
  word.selectNodeContents(document.getElementById("word"));
  const wide = word.getBoundingClientRect();
  if (view.scale === 1 && (wide.left < screen.left || wide.right > screen.right + 0.5)) {
    wrong.push(`the word is ${Math.round(wide.right - screen.right)} px outside`);
  }
  if (document.documentElement.scrollWidth > Math.ceil(view.width * view.scale)) {
    wrong.push(`the page is ${document.documentElement.scrollWidth} px wide, and the screen ${view.width}`);
  }
  for (const part of document.querySelectorAll("section, #pair, .hold button, #limit button")) {
    if (part.scrollWidth > part.clientWidth + 1) wrong.push(`${part.id || part.ariaLabel || part.textContent} is cut`);
  }
  return wrong;
})()""".replace("LEAST", str(LEAST_SHARE))

BROKEN = """
(() => {
  const wrong = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    if (!node.parentElement.checkVisibility() || node.parentElement.closest("script, style, noscript")) continue;
    for (const {0: word, index} of node.textContent.matchAll(/[^\\s\\/-]+/g)) {
      if (word.length > LONGEST) continue;
      const range = document.createRange();
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      if (new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size > 1) wrong.push(word);
    }
  }
  return wrong;
})()""".replace("LONGEST", str(LONGEST))


@pytest.fixture(scope="module")
def tab(trial: Trial) -> Iterator[Tab]:
    """The page of a robot that was stopped; what only paired devices see is shown too."""
    trial.enable()
    trial.robot.estop(f"layout {os.getpid()}")
    with Web(trial.name, state=trial.state) as web, Browser() as browser:
        found = browser.tab(web.url)
        found.until("document.getElementById('last-proof').checkVisibility()")
        found.until("document.querySelector('.card') !== null", "an incident", 30)
        found.run(
            "for (const id of ['buttons', 'attendance', 'drive', 'pair']) document.getElementById(id).hidden = false"
        )
        yield found


def shows(tab: Tab, text: int, word: str, *, failed: bool, forced: bool = False) -> None:
    """A text size in percent; the large word; the failure's words on STOP or none; forced colours."""
    tab.call("Page.setFontSizes", fontSizes={"standard": round(16 * text / 100), "fixed": round(13 * text / 100)})
    tab.call(
        "Emulation.setEmulatedMedia", features=[{"name": "forced-colors", "value": "active" if forced else "none"}]
    )
    tab.run(f"document.getElementById('word').textContent = {word!r}")
    tab.run(f"document.getElementById('word').classList.toggle('long', {len(word)} > 9)")
    said, phase = (FAILED, "failed") if failed else ("at a touch", "")
    tab.run(f"document.getElementById('stop').dataset.phase = {phase!r}")
    tab.run(f"document.getElementById('stop-said').textContent = {said!r}")


def wrong(tab: Tab, script: str) -> list[str]:
    """Faults that a script finds with what is on the screen, once it is laid out."""
    tab.run("new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    found: list[str] = tab.run(script)
    return found


@pytest.mark.parametrize(("wide", "high"), SCREENS, ids=lambda px: str(px))
def test_stop_is_on_the_screen_at_every_text_size_and_zoom(tab: Tab, wide: int, high: int) -> None:
    sizes = [*((text, 100) for text in TEXTS), *((100, zoom) for zoom in ZOOMS)]
    found: dict[Any, list[str]] = {}
    for (text, zoom), failed, forced in itertools.product(sizes, (False, True), (False, True)):
        tab.size(round(wide * 100 / zoom), round(high * 100 / zoom), touch=min(wide, high) < 600)
        for word in WORDS if not forced else WORDS[:1]:
            shows(tab, text, word, failed=failed, forced=forced)
            if said := wrong(tab, SEEN):
                found[text, zoom, word, "failed" if failed else "", "forced" if forced else ""] = said
    assert not found


def test_stop_is_on_the_screen_when_two_fingers_have_enlarged_it(tab: Tab) -> None:
    tab.size(390, 844)
    shows(tab, 100, "STOPPED", failed=True)
    try:
        for scale in (1.5, 3.0):
            tab.call("Emulation.setPageScaleFactor", pageScaleFactor=scale)
            tab.until(f"visualViewport.scale > {scale} - 0.1")
            assert wrong(tab, SEEN) == [], scale
    finally:
        tab.call("Emulation.setPageScaleFactor", pageScaleFactor=1.0)
        tab.until("visualViewport.scale === 1")


def test_a_phone_on_its_side_shows_reset_and_enable(tab: Tab) -> None:
    shows(tab, 100, "STOPPED", failed=False)
    for wide, high in ((844, 390), (915, 412)):
        tab.size(wide, high)
        tab.run("scrollTo(0, 0); document.getElementById('pair').hidden = true")
        for name in ("reset", "enable"):
            box = tab.run(f"document.getElementById('{name}').getBoundingClientRect().toJSON()")
            assert box["top"] >= 0, name
            assert box["bottom"] <= high, name


def test_forced_colours_leave_stop_an_edge(tab: Tab) -> None:
    tab.size(390, 844)
    for failed in (False, True):
        shows(tab, 100, "STOPPED", failed=failed, forced=True)
        edge = tab.run(
            "(({borderTopStyle: style, borderTopWidth: wide, borderTopColor: colour, backgroundColor: back}) =>"
            " [style, parseFloat(wide), colour !== back])(getComputedStyle(document.getElementById('stop')))"
        )
        assert edge[0] in ("solid", "dashed", "double")
        assert edge[1] >= 2
        assert edge[2], "the edge has the colour of what is inside"


@pytest.mark.parametrize(("wide", "high"), [(320, 568), (390, 844), (844, 390), (1280, 720)], ids=str)
def test_no_word_is_broken(tab: Tab, wide: int, high: int) -> None:
    tab.size(wide, high, touch=wide < 1000)
    for word in WORDS:
        shows(tab, 100, word, failed=True)
        assert wrong(tab, BROKEN) == []


CARDS = """
(() => {
  window.fetched = window.fetch;
  window.fetch = async (url, ...more) => url !== "/api/incidents" ? fetched(url, ...more) : new Response(JSON.stringify(
    {incidents: Array.from({length: 20}, (_, at) => ({id: `made-${at}`, t: 1700000000 + 46800 * at,
      reason: "operator gone: Anna's phone, was not heard for 1003 ms", proof: "written after 90 us"}))}));
  dispatchEvent(new Event("link-open"));
})()"""


def test_a_long_history_leaves_the_page_short_and_the_older_a_touch_away(tab: Tab) -> None:
    tab.size(390, 844)
    shows(tab, 100, "STOPPED", failed=False)
    tab.run(CARDS)
    tab.until("document.querySelectorAll('.card').length === 20")
    assert tab.run("[...document.querySelectorAll('.card')].filter((card) => card.checkVisibility()).length") == 5
    assert tab.run("document.getElementById('incidents').offsetHeight") < 844
    assert tab.run("document.getElementById('events').offsetHeight") < 844
    tab.run("document.querySelector('#incidents > details:last-child > summary').click()")
    assert tab.run("[...document.querySelectorAll('.card')].every((card) => card.checkVisibility())")
    clocks = tab.run("[...document.querySelectorAll('.card small')].map((line) => line.textContent)")
    assert not any("AM" in line or "PM" in line for line in clocks)
    tab.run("window.fetch = window.fetched; dispatchEvent(new Event('link-open'))")

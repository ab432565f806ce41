"""A page that stays open over runs of the service and over days, in a real browser. `make web` runs it."""

from __future__ import annotations

import json
import re
import time

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.web.browser import CHROMIUM, Browser
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

WORD = "document.getElementById('word').textContent"
DAYS = 3
OLD = """
(() => { const found = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage");
  Object.defineProperty(WebSocket.prototype, "onmessage", {set(run) { found.set.call(this, (event) => {
    const message = JSON.parse(event.data);
    if (message.view && message.view.stop) message.view.stop.t -= SECONDS;
    if (message.view) for (const each of message.view.events) if (each.kind === "stop") each.t -= SECONDS;
    run({data: JSON.stringify(message)});
  }); }}); })()"""
"""A robot that was stopped some days ago."""
COUNTED = """
(() => { const real = fetch;
  window.asked = 0;
  window.fetch = (path, ...more) => { if (path === "/api/incidents") window.asked++; return real(path, ...more); };
})()"""


def test_what_was_days_ago_is_shown_with_its_date(trial: Trial, web: Web, browser: Browser) -> None:
    trial.robot.estop("long ago")
    wait_for("the latch", lambda: trial.robot.state.estop)
    tab = browser.tab()
    tab.call("Page.addScriptToEvaluateOnNewDocument", source=OLD.replace("SECONDS", str(DAYS * 86400)))
    tab.open(web.url)
    tab.until("document.getElementById('last-reason').textContent.includes('long ago')")
    tab.until("document.getElementById('events').childElementCount > 1")
    year = time.strftime("%Y", time.localtime(time.time() - DAYS * 86400))
    assert year in tab.text("#last-reason")
    times = tab.run("[...document.querySelectorAll('#events time')].map((each) => each.textContent)")
    assert any(year in each for each in times)
    assert any(re.fullmatch(r"[0-9:]+", each) for each in times), "those of today"
    assert tab.errors == []
    tab.open("about:blank")


def test_an_incident_of_the_next_run_is_looked_for_though_its_event_has_the_same_number(browser: Browser) -> None:
    with Web("web-nobody") as page:
        tab = browser.tab()
        tab.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTED)
        tab.open(page.url)
        tab.run("addEventListener('view', ({detail}) => { window.view = detail; })")
        tab.until(f"{WORD} === 'NO SERVICE' && asked > 0")
        tab.until("document.getElementById('shake').textContent === 'not known'")
        view = page.get("/api/state")["view"]

        def heard(run: str, number: int, t: float) -> None:
            event = {"seq": number, "t": t, "kind": "incident", "level": "info", "text": "saved"}
            found = json.dumps({**view, "run": run, "events": [event]})
            tab.run(f"dispatchEvent(new CustomEvent('view', {{detail: {found}}}))")

        before = tab.run("asked")
        for count, (run, number, t) in enumerate((("a", 5, 1.0), ("a", 6, 2.0), ("b", 6, 2.0), ("b", 6, 3.0)), 1):
            heard(run, number, t)
            heard(run, number, t)
            tab.until(f"asked >= {before + count}")
        assert tab.errors == []
        tab.open("about:blank")

"""STOP always leaves the page, in a real browser: with every connection taken, without a network, behind a proxy."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.web.storage import Storage
from failstop_lab.trial import Trial, wait_for
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.front import Front
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
WORD = "document.getElementById('word').textContent"
SAID = "document.getElementById('stop-said').textContent"
SEEN = f"{WORD} !== 'CONNECTING' && {WORD} !== 'NO CONTACT'"
TAKEN = "/taken/"
CONNECTIONS = 6
TAKE = f"for (let at = 0; at < {CONNECTIONS + 4}; at++) fetch('{TAKEN}' + at).catch(() => {{}}); 0"
SOON_S = 2.0
TWENTY_TIMES = """
(() => { const real = setTimeout, wide = fetch;
  window.setTimeout = (run, ms, ...more) => real(run, ms / 20, ...more);
  window.asked = 0;
  window.fetch = (path, ...more) => { if (path === "/api/stop") window.asked++; return wide(path, ...more); };
})()"""
"""A page whose timers are twenty times as fast, and that counts its requests to stop."""
OLDER_S = 1.0
FIRST = 65
"""Tries; after 60 it is tried less often."""


@pytest.fixture
def front(web: Web) -> Iterator[Front]:
    """The server that the browser talks to."""
    with Front(web.port, holds=(TAKEN,)) as running:
        yield running


@pytest.fixture
def tab(browser: Browser, front: Front) -> Iterator[Tab]:
    """A page that sees the robot through it."""
    found = browser.tab(front.url)
    found.until(SEEN)
    yield found
    assert found.errors == []
    found.open("about:blank")


def driving(trial: Trial) -> int:
    """The wheels turn; returns the epoch."""
    trial.enable()
    trial.drive(0.2)
    assert trial.turning()
    return trial.robot.state.epoch


def stops_soon(trial: Trial, tab: Tab, before: int) -> None:
    """A tap stops the robot, and the page says so and never that it did not."""
    since_s = time.monotonic()
    tab.run(
        "window.told = []; new MutationObserver(() => told.push(document.getElementById('stop-said').textContent))"
        ".observe(document.getElementById('stop-said'), {childList: true, characterData: true, subtree: true})"
    )
    tab.tap("#stop")
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    assert time.monotonic() - since_s < SOON_S
    tab.until(f"{SAID}.includes('written')")
    assert not [text for text in tab.run("told") if "NOT" in text]


def test_a_stop_leaves_while_every_connection_is_taken(trial: Trial, front: Front, tab: Tab) -> None:
    before = driving(trial)
    tab.run(TAKE)
    wait_for("the connections", lambda: len(front.held) >= CONNECTIONS)
    stops_soon(trial, tab, before)
    assert len(front.held) >= CONNECTIONS


def test_a_stop_leaves_while_every_connection_is_taken_and_the_websockets_come_back(
    trial: Trial, front: Front, tab: Tab
) -> None:
    before = driving(trial)
    tab.run(TAKE)
    wait_for("the connections", lambda: len(front.held) >= CONNECTIONS)
    front.cut("/api/live", "/api/stop/live")
    stops_soon(trial, tab, before)
    assert len(front.held) >= CONNECTIONS


def test_a_stop_leaves_while_all_connections_are_taken_and_the_websocket_is_dumb(
    trial: Trial, front: Front, tab: Tab
) -> None:
    before = driving(trial)
    tab.run(TAKE)
    wait_for("the connections", lambda: len(front.held) >= CONNECTIONS)
    front.lose("/api/stop/live")
    tab.tap("#stop")
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    tab.until(f"{SAID}.includes('written') && !{SAID}.includes('NOT')")
    assert len(front.held) >= CONNECTIONS


def test_a_stop_leaves_while_another_page_of_the_browser_takes_every_connection(
    trial: Trial, browser: Browser, front: Front, tab: Tab
) -> None:
    other = browser.tab(front.url)
    other.until(SEEN)
    other.run(TAKE)
    tab.call("Page.bringToFront")
    wait_for("the connections", lambda: len(front.held) >= CONNECTIONS)
    stops_soon(trial, tab, driving(trial))
    other.open("about:blank")


def test_opened_cards_take_one_connection_and_give_it_up_for_a_stop(trial: Trial, front: Front, tab: Tab) -> None:
    for number in range(4):
        trial.robot.estop(f"card {number}")
        wait_for("the latch", lambda: trial.robot.state.estop)
        trial.robot.reset()
    tab.until("document.querySelectorAll('.card').length >= 4", "four cards", 30)
    front.holds = (TAKEN, "/api/incidents/")
    before = driving(trial)
    tab.run("for (const card of document.querySelectorAll('.card summary')) card.click()")
    wait_for("a story that is waited for", lambda: front.held)
    assert len(front.held) == 1
    stops_soon(trial, tab, before)
    wait_for("the connection to be given up", lambda: not front.held)


STOPPED = (
    "dispatchEvent(new CustomEvent('stopped', "
    "{detail: {asked: Date.now() / 1000, sent: performance.now(), written: true, view: FACE}}))"
)
LATCHED = "{...view, latched: true, epoch: view.epoch + 1}"


def test_a_state_from_before_a_stop_that_comes_after_the_word_of_it_ends_nothing(trial: Trial, tab: Tab) -> None:
    tab.run("addEventListener('view', ({detail}) => { window.view = detail; })")
    tab.run("window.over = 0; addEventListener('unstopped', () => { over++; })")
    trial.robot.estop("one that is shown")
    wait_for("the latch", lambda: trial.robot.state.estop)
    driving(trial)
    tab.until("window.view && view.enabled && view.stop")
    tab.run("dispatchEvent(new Event('stopping'))")
    for percent, found in ((90, "view"), (80, LATCHED)):
        tab.run(STOPPED.replace("FACE", found))
        trial.robot.limit_speed(percent / 100)
        tab.until(f"view.limit === {percent} && !view.latched")
        assert tab.run("over") == 0
    trial.robot.estop("somebody's")
    tab.until("view.latched")
    trial.robot.reset()
    tab.until("over === 1")
    trial.robot.limit_speed(1.0)


@pytest.mark.parametrize("contact", [True, False])
def test_a_restart_of_the_service_ends_the_stop_on_the_button(browser: Browser, *, contact: bool) -> None:
    """The robot drives again, in a run that counts its stops from the beginning, whether the page saw the restart or
    not."""
    with Trial(f"stop-anew-{os.getpid()}") as own, Web(own.name) as page, Front(page.port) as front:
        tab = browser.tab(front.url)
        tab.until(SEEN)
        tab.run("addEventListener('view', ({detail}) => { window.view = detail; })")
        before = driving(own)
        stops_soon(own, tab, before)
        tab.until(f"window.view && view.latched && {SAID}.includes('acknowledged')")
        if not contact:
            front.to = 9
            front.cut()
            tab.until(f"{WORD} === 'NO CONTACT'")
        own.service.end()
        own.service.start()
        assert driving(own) == before
        front.to = page.port
        tab.until("view.enabled")
        assert "written" not in tab.run(SAID)
        tab.open("about:blank")


def test_stop_is_tried_until_it_is_written_however_long(trial: Trial, front: Front, browser: Browser) -> None:
    """A network that delivers nothing, and then does."""
    tab = browser.tab()
    tab.call("Page.addScriptToEvaluateOnNewDocument", source=TWENTY_TIMES)
    tab.open(front.url)
    tab.until(SEEN)
    before = driving(trial)
    front.to, to = 9, front.to
    front.cut()
    lift = tab.press("#stop")
    tab.until(f"{SAID}.includes('NOT WRITTEN') && {SAID}.includes('POWER SWITCH')")
    lift()
    tab.until(f"window.asked >= {FIRST}", timeout_s=30)
    tab.until(f"{WORD} === 'NO CONTACT'")
    assert trial.robot.state.epoch == before
    front.to = to
    wait_for("the stop", lambda: trial.robot.state.epoch > before, 10)
    tab.until(f"{SAID}.includes('written') && !{SAID}.includes('NOT')")
    tab.open("about:blank")


def test_an_older_stop_that_the_page_learns_of_late_does_not_end_the_tries(
    trial: Trial, front: Front, tab: Tab
) -> None:
    """Without contact, somebody else stops the robot. Then the state comes back before this page's STOP gets out."""
    tab.run("addEventListener('view', ({detail}) => { window.view = detail; })")
    front.to, to = 9, front.to
    front.cut()
    tab.until(f"{WORD} === 'NO CONTACT'")
    trial.robot.estop("somebody else")
    wait_for("the latch", lambda: trial.robot.state.estop)
    before = trial.robot.state.epoch
    since_s = time.time()
    wait_for("a stop that is older than the touch", lambda: time.time() - since_s > OLDER_S)
    tab.tap("#stop")
    front.holds = (TAKEN, "/api/stop")
    front.to = to
    tab.until("window.view && view.latched && view.stop.acknowledged")
    assert "written" not in tab.run(SAID)
    assert trial.robot.state.epoch == before
    front.holds = (TAKEN,)
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    tab.until(f"{SAID}.includes('written') && !{SAID}.includes('NOT')")
    tab.until(f"{SAID}.includes('a stop was latched already')")
    assert "acknowledged" not in tab.run(SAID), "it is the proof of another stop"


def test_a_websocket_that_neither_opens_nor_fails_leaves_the_page_state_and_stop(
    trial: Trial, front: Front, browser: Browser
) -> None:
    front.holds = ("/api/live", "/api/stop/live")
    tab = browser.tab(front.url)
    tab.until(SEEN)
    stops_soon(trial, tab, driving(trial))
    tab.until(f"{WORD} === 'STOPPED'")
    tab.open("about:blank")


@pytest.mark.parametrize("rest", ["%", "%zz", "%E0%A4%A", "?", "<b>"])
def test_what_follows_the_address_does_the_page_no_harm(browser: Browser, web: Web, rest: str) -> None:
    tab = browser.tab(f"{web.url}#{rest}")
    tab.until(SEEN)
    assert tab.errors == []
    assert tab.run("document.getElementById('code').value") == ""
    tab.open("about:blank")


def test_while_the_board_is_away_the_page_says_what_is_known(browser: Browser) -> None:
    """The stop is latched, and not at the board: the power switch is what is left."""
    with Trial(f"stop-gone-{os.getpid()}") as lost, Web(lost.name) as page:
        tab = browser.tab(page.url)
        tab.until(SEEN)
        lost.board.unplug()
        wait_for("the loss", lambda: "is gone" in lost.service.said())
        tab.tap("#stop")
        tab.until(f"{SAID}.includes('latched') && {SAID}.includes('POWER SWITCH')")
        lost.board.replug()
        tab.until(f"{SAID}.includes('written')")
        tab.open("about:blank")


@pytest.fixture
def proxy(tmp_path: Path) -> Iterator[Front]:
    """A proxy that ends TLS."""
    with Front(tls=Storage(str(tmp_path / "proxy")).tls(["localhost"])) as running:
        yield running


def test_behind_a_proxy_that_ends_tls_a_page_that_cannot_stop_says_so_when_it_opens(
    web: Web, browser: Browser, proxy: Front
) -> None:
    proxy.to = web.port
    tab = browser.tab(proxy.url)
    tab.until(f"{SAID}.includes(\"CAN'T STOP\") && {SAID}.includes('web.origin')")
    tab.open("about:blank")


def test_behind_a_proxy_that_ends_tls_a_setting_makes_it_work(
    trial: Trial, browser: Browser, proxy: Front, tmp_path: Path
) -> None:
    config = tmp_path / "web.toml"
    config.write_text(f'[web]\npairing = "on"\norigin = "{proxy.url}"\n')
    with Web(trial.name, "--config", str(config), state=str(tmp_path)) as page:
        proxy.to = page.port
        assert f"page  {proxy.url}" in page.command("pair").stdout
        tab = browser.tab(f"{proxy.url}#{page.code()}")
        tab.until(SEEN)
        tab.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
        tab.run("document.querySelector('#pair form').requestSubmit()")
        tab.until("!document.getElementById('buttons').hidden")
        stops_soon(trial, tab, driving(trial))
        tab.until("document.getElementById('reset').getAttribute('aria-disabled') === 'false'")
        assert tab.run("document.cookie") == ""
        tab.open("about:blank")

"""The page in a real browser: every button, a lost network, a phone that sleeps. Needs chromium: `make web`."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from failstop.api import distance
from failstop.policy.settings import Settings
from failstop_lab.trial import Trial, judge, wait_for
from tests.support.waiting import STORY_S
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.driving_parts import enable_soon
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

LEASE_S = 0.5
IMU_HZ = 110.0
"""A stop is seen to be one by the samples of a real board."""
SETTINGS = f'[attend]\nrequired = "on"\nlease_s = {LEASE_S}\n[web]\npairing = "on"\n'
WORD = "document.getElementById('word').textContent"
SAID = "document.getElementById('stop-said').textContent"


@pytest.fixture(scope="module")
def tab(browser: Browser, web: Web) -> Iterator[Tab]:
    """A phone that shows the page, not paired yet; no script of it may throw."""
    found = browser.tab(web.url)
    found.until(f"{WORD} !== 'CONNECTING'")
    yield found
    assert found.errors == []


HELD_BACK = """
(() => { const real = fetch;
  window.letGo = null;
  window.fetch = async (url, ...more) => {
    const answer = await real(url, ...more);
    if (url === "/api/me") { window.fetch = real; await new Promise((go) => { window.letGo = go; }); }
    return answer;
  };
  dispatchEvent(new Event("link-open"));
})()"""
"""Hold back the answer to the page's next question about itself, and let it be heard later."""


@pytest.fixture(scope="module")
def paired(tab: Tab, web: Web) -> Tab:
    """A page that is paired with a photographed code, while an answer from before that is still on its way."""
    code = web.code()
    tab.open("about:blank")
    tab.open(f"{web.url}#{code}")
    tab.until(f"document.getElementById('code').value === '{code}'")
    assert tab.run("location.hash") == "", "the code does not stay in the history"
    tab.until("!document.getElementById('pair').hidden")
    tab.run("document.getElementById('device-name').value = 'Anna'")
    tab.run(HELD_BACK)
    tab.until("window.letGo !== null")
    tab.tap("#pair button")
    tab.until("!document.getElementById('attendance').hidden")
    tab.run("letGo()")
    return tab


def driving(trial: Trial, tab: Tab) -> None:
    """Somebody attends by this page, and the robot drives, for so long that the IMU feels it."""

    def felt() -> bool:
        trial.drive(0.1)
        return trial.robot.state.turning.does == "turning"

    trial.robot.disable()
    if tab.run("document.getElementById('attend').getAttribute('aria-pressed')") != "true":
        tab.tap("#attend")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Anna",))
    enable_soon(trial)
    wait_for("the IMU to feel it", felt)
    assert trial.turning()
    trial.board.events()


def test_a_stranger_sees_and_stops_and_nothing_else(trial: Trial, tab: Tab) -> None:
    tab.until("!document.getElementById('pair').hidden")
    assert tab.run("document.getElementById('buttons').hidden")
    assert tab.run("document.getElementById('attendance').hidden")


def test_a_wrong_code_is_told(tab: Tab) -> None:
    tab.tap("#pair summary")
    tab.run("document.getElementById('code').value = '0000-0000'")
    tab.tap("#pair button")
    tab.until("document.getElementById('pair-why').textContent.includes('no code is valid now')")


def test_space_in_a_field_is_a_space(trial: Trial, tab: Tab) -> None:
    before = trial.robot.state.epoch
    tab.run("document.getElementById('device-name').focus()")
    tab.key(" ", "Space", 32)
    assert tab.run("document.getElementById('device-name').value") == " "
    assert trial.robot.state.epoch == before
    tab.run("document.activeElement.blur()")


@pytest.mark.parametrize(("key", "code", "number"), [(" ", "Space", 32), ("Escape", "Escape", 27)])
def test_keys_stop(trial: Trial, tab: Tab, key: str, code: str, number: int) -> None:
    before = trial.robot.state.epoch
    tab.key(key, code, number)
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    tab.until(f"{SAID}.includes('written')")


def test_a_stranger_is_told_of_no_button_that_it_has_not(trial: Trial, tab: Tab) -> None:
    assert trial.robot.state.estop
    tab.until("document.getElementById('next').textContent.includes('reset it with a paired device')")
    assert "RESET" not in tab.text("#next")


def test_the_finger_is_still_down_when_the_wheels_stop(trial: Trial, paired: Tab) -> None:
    driving(trial, paired)
    asked_ns = time.monotonic_ns()
    lift = paired.press("#stop")
    wait_for("the latch", lambda: trial.robot.state.estop)
    seen = judge(trial.board.events(), asked_ns, was_turning=True)
    assert seen.stop_ns is not None
    assert seen.motion_after == 0
    lift()
    paired.until(f"{WORD} === 'STOPPED'")
    paired.until(f"{SAID}.includes('acknowledged') && {SAID}.includes('observed')")
    assert "asked for a stop" in paired.text("#why")


WATCHED = """
window.words = [];
new MutationObserver(() => window.words.push(document.getElementById("word").textContent))
  .observe(document.getElementById("word"), {childList: true, characterData: true, subtree: true})"""


def test_the_word_says_no_more_than_is_proved(trial: Trial, paired: Tab) -> None:
    """A deaf board turns its wheels on, whatever is written to it."""
    driving(trial, paired)
    paired.run(WATCHED)
    trial.board.deaf(True)
    try:
        paired.tap("#stop")
        paired.until(f"{WORD} === 'WHEELS MAY TURN'")
        assert "STOPPED" not in paired.run("words")
        assert paired.run("words.at(-2)") == "STOP WRITTEN"
    finally:
        trial.board.deaf(False)
    paired.until(f"{WORD} === 'STOPPED'")


def held(tab: Tab, selector: str, what: str, check: Callable[[], object]) -> None:
    """Hold a button until it has worked; once more where the page asks for that, as on a busy machine."""
    answer = "document.getElementById('answer').textContent"
    for _ in range(5):
        lift = tab.press(selector)
        tab.until(f"document.querySelector({json.dumps(selector)}).classList.contains('held')")
        tab.until(f"document.querySelector({json.dumps(selector)}).classList.contains('held') === false", what, 10)
        tab.until(f"{answer} !== '' && {answer} !== 'asking ...'", what)
        lift()
        if "old again" not in tab.text("#answer"):
            break
    wait_for(what, check)


def test_reset_and_enable_are_held_and_letting_go_cancels(trial: Trial, paired: Tab) -> None:
    trial.robot.estop("to be reset")
    paired.until("document.getElementById('reset').getAttribute('aria-disabled') === 'false'")
    lift = paired.press("#reset")
    paired.until("document.getElementById('reset').classList.contains('held')")
    lift()
    paired.until("!document.getElementById('reset').classList.contains('held')")
    assert trial.robot.state.estop
    held(paired, "#reset", "the reset", lambda: not trial.robot.state.estop)
    if paired.run("document.getElementById('attend').getAttribute('aria-pressed')") != "true":
        paired.tap("#attend")
    paired.until("document.getElementById('enable').getAttribute('aria-disabled') === 'false'")
    held(paired, "#enable", "motion to be enabled", lambda: trial.robot.state.enabled)
    paired.until(f"{WORD} === 'CAN MOVE'")
    paired.tap("#disable")
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)


TOPS = """
window.tops = new Set();
(function look() {
  tops.add(JSON.stringify([...document.querySelectorAll("#buttons button, #attend")].map((button) =>
    [button.id || button.dataset.percent, Math.round(button.getBoundingClientRect().top + scrollY)])));
  requestAnimationFrame(look);
})()"""


def test_no_button_moves_while_the_state_changes(trial: Trial, paired: Tab) -> None:
    """A finger that is on its way lands on what it was meant for."""
    driving(trial, paired)
    paired.run(TOPS)
    paired.until(f"{WORD} === 'CAN MOVE'")
    paired.tap("#disable")
    paired.until(f"{WORD} === 'STOPPED'")
    enable_soon(trial)
    paired.until(f"{WORD} === 'CAN MOVE'")
    trial.robot.estop("a hand near the left front wheel")
    paired.until(f"{WORD} === 'STOPPED' && document.getElementById('next').textContent.includes('RESET')")
    trial.robot.reset()
    paired.until("!document.getElementById('next').textContent.includes('RESET')")
    assert len(paired.run("[...tops]")) == 1, "\n".join(paired.run("[...tops]"))


def test_a_lower_speed_takes_a_touch_and_a_higher_one_is_held(trial: Trial, paired: Tab) -> None:
    paired.tap("#limit [data-percent='25']")
    wait_for("the limit", lambda: trial.robot.state.speed_limit == 0.25)
    paired.until("document.querySelector('#limit [aria-pressed=true]').dataset.percent === '25'")
    stands = distance.WITHIN.format(distance.furthest(Settings(dict(trial.robot.settings)), 0.25)[0])
    paired.until(f"document.getElementById('facts').textContent.includes('Stops{stands}')")
    lift = paired.press("#limit [data-percent='100']")
    paired.until("document.querySelector('#limit .held') !== null")
    lift()
    paired.until("document.querySelector('#limit .held') === null")
    assert trial.robot.state.speed_limit == 0.25
    held(paired, "#limit [data-percent='100']", "the limit to go", lambda: trial.robot.state.speed_limit == 1.0)


def test_what_stands_in_the_way_is_said_instead_of_a_dead_button(trial: Trial, paired: Tab) -> None:
    wait_for("nothing latched", lambda: not trial.robot.state.estop)
    paired.tap("#reset")
    paired.until("document.getElementById('answer').textContent.includes('nothing is latched')")


def test_a_page_that_hears_nothing_shows_no_old_word(trial: Trial, web: Web, paired: Tab) -> None:
    os.kill(web.process.pid, signal.SIGSTOP)
    try:
        paired.until(f"{WORD} === 'NO CONTACT'", timeout_s=3)
        assert "Last known" in paired.text("#why")
        assert paired.run("document.title") == "NO CONTACT - failstop"
    finally:
        os.kill(web.process.pid, signal.SIGCONT)
    paired.until(f"{WORD} !== 'NO CONTACT'")


def test_a_page_that_is_hidden_gives_up_at_once(trial: Trial, browser: Browser, paired: Tab) -> None:
    driving(trial, paired)
    other = browser.tab()
    other.call("Page.bringToFront")
    trial.drive(LEASE_S + 0.2)
    assert "operator gone: Anna" in str(trial.robot.state.estop)
    assert not trial.turning()
    paired.call("Page.bringToFront")


def test_a_browser_that_is_suspended_stops_the_robot(trial: Trial, browser: Browser, paired: Tab) -> None:
    """A phone that falls asleep suspends its browser so."""
    driving(trial, paired)
    browser.signal(signal.SIGSTOP)
    suspended_ns = time.monotonic_ns()
    try:
        trial.drive(LEASE_S + 0.3)
        seen = judge(trial.board.events(), suspended_ns, was_turning=True)
    finally:
        browser.signal(signal.SIGCONT)
    assert "operator gone: Anna, was not heard" in str(trial.robot.state.estop)
    assert seen.stop_ns is not None
    assert seen.stop_ns / 1e9 < LEASE_S + 0.02
    assert seen.motion_after == 0


def test_an_incident_shows_its_story_and_its_picture(trial: Trial, paired: Tab) -> None:
    paired.until("document.querySelector('.card') !== null", "a card", 30)
    assert " ms, acknowledged after " in paired.text(".card small") or " us, acknowledged" in paired.text(".card small")
    paired.run("document.querySelector('.card summary').click()")
    picture = "document.querySelector('.card img')"
    paired.until(f"{picture}?.naturalWidth > 400 && !!document.querySelector('.card .cause')", "a picture", STORY_S)

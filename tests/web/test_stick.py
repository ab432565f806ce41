"""The page's thumb stick in a real browser: a finger, keys, a page that hangs or is hidden. `make web` runs it."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from failstop_lab.trial import Trial, TrialError, judge, wait_for
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.driving_parts import COMMAND_S, DRIVING, LATE_S, enable_soon
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]
IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
SETTINGS = DRIVING

WORD = "document.getElementById('word').textContent"
HELD = "document.getElementById('stick').classList.contains('held')"


@pytest.fixture(scope="module")
def tab(web: Web, browser: Browser) -> Iterator[Tab]:
    """A phone that is paired, attends, and has chosen a limit; no script may throw."""
    found = browser.tab(f"{web.url.replace('127.0.0.1', 'localhost')}#{web.code()}")
    found.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
    found.until(f"{WORD} === 'STOPPED'")
    found.run("document.getElementById('device-name').value = 'Dora'")
    found.tap("#pair button")
    found.until("!document.getElementById('drive').hidden")
    yield found
    assert found.errors == []


def takes_stick(trial: Trial, tab: Tab) -> None:
    """Attend, choose the limit, enable."""
    trial.robot.disable()
    trial.robot.limit_speed(1.0)
    if tab.run("document.getElementById('attend').getAttribute('aria-pressed')") != "true":
        tab.tap("#attend")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Dora",))
    tab.until("document.getElementById('limit').dataset.percent === '100'")
    tab.tap("#limit [data-percent='50']")
    wait_for("the limit", lambda: trial.robot.state.speed_limit == 0.5)
    enable_soon(trial)
    tab.until(f"{WORD} === 'CAN MOVE'")


def finger(tab: Tab, x: float, y: float, kind: str = "touchStart") -> None:
    """A finger on the stick, at a place from -1 to 1: right and up."""
    wide = tab.run("document.getElementById('stick').clientWidth")
    middle_x, middle_y = tab.place("#stick")
    point = {"x": middle_x + x * wide / 2, "y": middle_y - y * wide / 2}
    tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=[point])


def moved(
    trial: Trial, tab: Tab, begin: Callable[[], Callable[[], None]], check: Callable[[], bool]
) -> Callable[[], None]:
    """Take the stick until the robot moves so; again where the page asks for that, as on a busy machine. Returns how to
    let it go."""
    for _ in range(5):
        takes_stick(trial, tab)
        lift = begin()
        with contextlib.suppress(TrialError):
            wait_for("motion", check, 3)
            return lift
        lift()
    raise AssertionError(f"the stick moves nothing: {tab.text('#drive-why')}")


def thumb(tab: Tab) -> Callable[[], None]:
    """A finger goes up on the stick; returns how to lift it."""
    finger(tab, 0.0, 0.9)

    def lift() -> None:
        tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    return lift


ABOVE_STOP = (
    "(() => {{ const text = document.getElementById('{id}'), {{top, bottom}} = text.getBoundingClientRect(); "
    "const covered = document.getElementById('bar').getBoundingClientRect().top; "
    "return text.textContent !== '' && top >= 0 && bottom <= covered; }})()"
)
"""Whether a text is on the screen and STOP does not cover it."""
PRESSED = "[...document.querySelectorAll('#limit [aria-pressed=true]')].map((each) => each.dataset.percent).join()"


def test_no_limit_is_marked_as_chosen_before_it_was_and_the_reason_is_to_be_seen(trial: Trial, tab: Tab) -> None:
    tab.size(390, 844)
    trial.robot.disable()
    trial.robot.limit_speed(1.0)
    tab.until(f"{PRESSED} === '100'")
    if tab.run("document.getElementById('attend').getAttribute('aria-pressed')") != "true":
        tab.tap("#attend")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Dora",))
    tab.until(f"{PRESSED} === ''")
    assert "choose one before you drive" in tab.text("#limit-how")
    tab.run("document.getElementById('stick').scrollIntoView({block: 'end'})")
    lift = thumb(tab)
    tab.until("document.getElementById('drive-why').textContent.includes('choose the speed limit first')")
    lift()
    assert tab.run(ABOVE_STOP.format(id="drive-why"))
    tab.tap("#limit [data-percent='50']")
    tab.until(f"{PRESSED} === '50'")
    tab.size(412, 915)


def test_a_stick_that_is_taken_before_the_device_attends_says_what_comes_first(trial: Trial, tab: Tab) -> None:
    if tab.run("document.getElementById('attend').getAttribute('aria-pressed')") == "true":
        tab.tap("#attend")
    tab.until("document.getElementById('attend').getAttribute('aria-pressed') === 'false'")
    finger(tab, 0.0, 0.5)
    assert tab.text("#drive-why") == "Not now: press ATTEND first."
    assert not tab.run(HELD)
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    takes_stick(trial, tab)
    finger(tab, 0.0, 0.5)
    assert tab.text("#drive-why") == ""
    trial.robot.disable()
    tab.until("document.getElementById('drive-why').textContent.startsWith('Motion is disabled now.')")
    assert not tab.run(HELD)
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    finger(tab, 0.0, 0.5)
    assert tab.text("#drive-why") == "Not now: motion is disabled. Enable it, then hold the stick."
    assert not tab.run(HELD)
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


def test_a_thumb_drives_and_letting_go_stops(trial: Trial, tab: Tab) -> None:
    def to_the_right() -> Callable[[], None]:
        lift = thumb(tab)
        finger(tab, 0.9, 0.0, "touchMove")
        return lift

    moved(trial, tab, lambda: thumb(tab), lambda: trial.robot.state.body_vel.vx_mps > 0.05)()
    lift = moved(trial, tab, to_the_right, lambda: trial.robot.state.body_vel.wz_radps < -0.2)
    trial.board.events()
    since_ns = time.monotonic_ns()
    lift()
    wait_for("rest", lambda: not trial.turning())
    seen = judge(trial.board.events(), since_ns, was_turning=True)
    assert seen.stop_ns is not None
    assert seen.stop_ns / 1e9 < COMMAND_S
    assert trial.robot.state.enabled


def test_arrow_keys_drive_while_they_are_held_and_space_stops(trial: Trial, tab: Tab) -> None:
    def key(name: str, number: int) -> Callable[[], None]:
        tab.run("document.getElementById('stick').focus()")
        return tab.hold_key(name, name, number)

    lift = moved(trial, tab, lambda: key("ArrowDown", 40), lambda: trial.robot.state.body_vel.vx_mps < -0.05)
    lift()
    wait_for("rest", lambda: not trial.turning())
    assert trial.robot.state.enabled
    lift = moved(trial, tab, lambda: key("ArrowUp", 38), trial.turning)
    tab.key(" ", "Space", 32)
    wait_for("the stop", lambda: trial.robot.state.estop)
    lift()
    tab.until(f"{WORD} === 'STOPPED'")


def test_a_page_that_is_held_up_drives_no_further(trial: Trial, tab: Tab) -> None:
    """The finger is lifted while the page hangs: what comes after it is no command."""
    lift = moved(trial, tab, lambda: thumb(tab), trial.turning)
    trial.board.events()
    since_ns = time.monotonic_ns()
    tab.run("(() => { const until = performance.now() + 800; while (performance.now() < until); })()")
    tab.until("document.getElementById('drive-why').textContent.includes('again')")
    seen = judge(trial.board.events(), since_ns, was_turning=True)
    assert seen.stop_ns is not None
    assert seen.stop_ns / 1e9 < COMMAND_S + LATE_S
    assert seen.motion_after == 0
    lift()


def test_a_browser_that_hangs_drives_no_further_and_attends_no_more(trial: Trial, tab: Tab, browser: Browser) -> None:
    """Its main process hangs while a thumb is on the stick: the page goes on, with a finger that nobody feels."""
    lift = moved(trial, tab, lambda: thumb(tab), trial.turning)
    trial.board.events()
    since_ns = time.monotonic_ns()
    os.kill(browser.process.pid, signal.SIGSTOP)
    try:
        wait_for("rest", lambda: not trial.turning(), 5)
        wait_for("the operator to be gone", lambda: trial.robot.state.estop, 5)
        assert "operator gone: Dora" in str(trial.robot.state.estop)
        seen = judge(trial.board.events(), since_ns, was_turning=True)
        print(f"stop after {(seen.stop_ns or 0) / 1e9:.3f} s, at rest after {(seen.still_ns or 0) / 1e9:.3f} s")
        assert seen.motion_after == 0
    finally:
        os.kill(browser.process.pid, signal.SIGCONT)
    tab.until("document.getElementById('drive-why').textContent.includes('again')")
    assert not tab.run(HELD)
    lift()


def test_a_hidden_page_drives_nothing(trial: Trial, web: Web, tab: Tab) -> None:
    lift = moved(trial, tab, lambda: thumb(tab), trial.turning)
    trial.board.events()
    since_ns = time.monotonic_ns()
    tab.run(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true}); "
        "document.dispatchEvent(new Event('visibilitychange', {bubbles: true})); delete document.hidden"
    )
    wait_for("the stop", lambda: trial.robot.state.estop)
    assert "operator gone: Dora" in str(trial.robot.state.estop)
    trial.board.wait_for(lambda event: event.is_stop and event.arrival_ns >= since_ns, 5)
    assert judge(trial.board.events(), since_ns, was_turning=True).motion_after == 0
    assert not tab.run(HELD)
    lift()


def test_a_wrong_code_is_said_where_stop_does_not_cover_it(web: Web, browser: Browser) -> None:
    phone = browser.tab(web.url, wide=390, high=844)
    phone.until("!document.getElementById('pair').hidden")
    phone.run("document.getElementById('pair').open = true")
    web.code()
    phone.run("document.getElementById('code').value = '0000-0000'")
    # The button just above STOP, as a person scrolls to it: what follows it is covered.
    phone.run(
        "(() => { const {top} = document.getElementById('bar').getBoundingClientRect(); "
        "const {bottom} = document.querySelector('#pair button').getBoundingClientRect(); "
        "document.getElementById('head').style.marginBottom = `${top - bottom}px`; })()"
    )
    phone.run("document.querySelector('#pair form').requestSubmit()")
    phone.until("document.getElementById('pair-why').textContent.includes('wrong code')")
    assert phone.run(ABOVE_STOP.format(id="pair-why"))


def test_a_device_that_is_revoked_is_told_at_once(web: Web, browser: Browser) -> None:
    phone = browser.tab(f"{web.url}#{web.code()}")  # another origin than the phone that drives
    phone.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
    phone.run("document.getElementById('device-name').value = 'Rita'")
    phone.tap("#pair button")
    phone.until("document.getElementById('role').textContent.includes('(Rita)')")
    rows = [line.split() for line in web.command("devices").stdout.splitlines()]
    [identity] = [row[0] for row in rows if row[-1] == "Rita"]
    assert web.command("revoke", identity).returncode == 0
    phone.until("document.getElementById('role').textContent === 'This device can watch and stop the robot.'")
    phone.until("document.getElementById('buttons').hidden")

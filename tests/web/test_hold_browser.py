"""A hold in a real browser: one that was let go enables nothing, however the page stalls meanwhile."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from failstop.web.hold import GAP_S, HOLD_S, SURE_S
from failstop_lab.trial import Trial, wait_for
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

LET_GO_S = 1.4
STALL_S = 1.5
AFTER_S = HOLD_S + GAP_S + SURE_S
ANSWER = "document.getElementById('answer').textContent"
BUTTON = "document.getElementById('{}')"
SETTINGS = '[web]\npairing = "on"\n'


@pytest.fixture(scope="module")
def tab(browser: Browser, web: Web) -> Iterator[Tab]:
    """A paired phone."""
    found = browser.tab(f"{web.url}#{web.code()}")
    found.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
    found.run("document.querySelector('#pair form').requestSubmit()")
    found.until("!document.getElementById('buttons').hidden")
    yield found
    assert found.errors == []


@pytest.fixture
def ready(trial: Trial, tab: Tab) -> Trial:
    """Motion could be enabled."""
    if trial.robot.state.estop:
        trial.robot.reset()
    trial.robot.disable()
    tab.until(f"{BUTTON.format('enable')}.getAttribute('aria-disabled') === 'false'")
    return trial


@pytest.fixture
def latched(trial: Trial, tab: Tab) -> Trial:
    """A reset could be asked for."""
    trial.robot.estop("the first")
    tab.until(f"{BUTTON.format('reset')}.getAttribute('aria-disabled') === 'false'")
    tab.until("document.getElementById('last-reason').textContent.includes('the first')")
    return trial


def pressed(tab: Tab, verb: str) -> None:
    """A finger is down, and the hold has begun: once the page has its connection again."""

    def begun() -> bool:
        lift = tab.press(f"#{verb}")
        held = bool(tab.run(f"{BUTTON.format(verb)}.classList.contains('held')"))
        if not held:
            lift()
        return held

    wait_for("a hold", begun)


def lift(tab: Tab) -> None:
    """The finger goes up, whether the browser hears of it now or later."""
    tab.tell("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


@contextmanager
def suspended(processes: list[psutil.Process]) -> Iterator[None]:
    for each in processes:
        each.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        for each in processes:
            each.send_signal(signal.SIGCONT)


def renderers(browser: Browser) -> list[psutil.Process]:
    """The processes that run the pages."""
    found = psutil.Process(browser.process.pid).children(recursive=True)
    return [each for each in found if "--type=renderer" in each.cmdline()]


def everything(browser: Browser) -> list[psutil.Process]:
    """Stop everything of the browser, as of a device that is asleep."""
    own = psutil.Process(browser.process.pid)
    return [own, *own.children(recursive=True)]


def main_process(browser: Browser) -> list[psutil.Process]:
    """The one that hears of fingers: the page itself goes on without it."""
    return [psutil.Process(browser.process.pid)]


@pytest.mark.parametrize("stalled", [renderers, everything, main_process])
@pytest.mark.parametrize("round_", range(3))
def test_a_finger_that_is_lifted_while_the_browser_stands_still_enables_nothing(
    ready: Trial, browser: Browser, tab: Tab, stalled: Callable[[Browser], list[psutil.Process]], round_: int
) -> None:
    pressed(tab, "enable")
    time.sleep(LET_GO_S)
    with suspended(stalled(browser)):
        lift(tab)
        time.sleep(STALL_S)
    tab.until("!document.querySelector('.held')")
    time.sleep(AFTER_S)
    assert not ready.robot.state.enabled


@pytest.mark.parametrize("blocked_s", [0.25, 1.5])
@pytest.mark.parametrize("from_s", [1.2, 1.8, 1.95, 2.0])
def test_a_finger_that_is_lifted_while_a_script_blocks_the_page_enables_nothing(
    ready: Trial, tab: Tab, from_s: float, blocked_s: float
) -> None:
    """The page is told of it when the script ends, and its timers are due then too."""
    block = f"const since = performance.now(); while (performance.now() - since < {blocked_s * 1e3});"
    tab.run(f"setTimeout(() => {{ window.blocked = 1; {block} window.blocked = 2; }}, {from_s * 1e3})")
    pressed(tab, "enable")
    time.sleep(from_s + 0.05)
    lift(tab)
    tab.until("window.blocked === 2")
    time.sleep(AFTER_S)
    assert not ready.robot.state.enabled
    tab.run("window.blocked = 0")


def test_sliding_off_cancels(ready: Trial, tab: Tab) -> None:
    pressed(tab, "enable")
    x, y = tab.place("#enable")
    tab.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x, "y": y + 20}])
    assert tab.run("!!document.querySelector('.held')"), "it is on the button still"
    tab.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x, "y": y + 200}])
    tab.until("!document.querySelector('.held')")
    tab.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x, "y": y}])
    time.sleep(AFTER_S)
    lift(tab)
    assert not ready.robot.state.enabled


def test_a_page_whose_words_all_come_late_enables_nothing(ready: Trial, web: Web, tab: Tab) -> None:
    """The server stands still for a whole hold, and then hears all of it at once; its begin too, where that was still
    on its way: such a hold is let go of before it is one."""
    pressed(tab, "enable")
    os.kill(web.process.pid, signal.SIGSTOP)
    try:
        time.sleep(HOLD_S + 0.5)
    finally:
        os.kill(web.process.pid, signal.SIGCONT)
    time.sleep(GAP_S)
    lift(tab)
    time.sleep(AFTER_S)
    assert not ready.robot.state.enabled


@pytest.mark.parametrize("whose", ["own", "another's"])
def test_a_stop_while_reset_is_held_stays(latched: Trial, tab: Tab, whose: str) -> None:
    pressed(tab, "reset")
    before = latched.robot.state.epoch
    time.sleep(HOLD_S - 0.3)
    if whose == "own":
        tab.run("document.getElementById('stop').click()")
    else:
        latched.robot.estop("another")
    wait_for("the stop", lambda: latched.robot.state.epoch > before)
    time.sleep(AFTER_S)
    lift(tab)
    assert latched.robot.state.estop


def test_a_hold_of_enter_enables_and_its_end_cancels(ready: Trial, tab: Tab, tmp_path: Path) -> None:
    tab.run("document.getElementById('enable').focus()")
    key = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13}
    tab.call("Input.dispatchKeyEvent", type="rawKeyDown", **key)
    tab.until("!!document.querySelector('.held')")
    tab.call("Input.dispatchKeyEvent", type="keyUp", **key)
    tab.until("!document.querySelector('.held')")
    for _ in range(5):
        tab.call("Input.dispatchKeyEvent", type="rawKeyDown", **key)
        tab.until(f"!document.querySelector('.held') && {ANSWER} !== '' && {ANSWER} !== 'asking ...'")
        tab.call("Input.dispatchKeyEvent", type="keyUp", **key)
        if ready.robot.state.enabled:
            break
    assert ready.robot.state.enabled, tab.text("#answer")


def test_a_finger_that_stays_down_for_longer_than_it_must_is_no_second_touch(latched: Trial, tab: Tab) -> None:
    """The click that a browser makes of it, once it is lifted, is not a screen reader's."""

    def reset() -> bool:
        """A busy machine may hold the page up, which then cancels the hold."""
        pressed(tab, "reset")
        if "cleared" not in tab.until(f"!['', 'asking ...'].includes({ANSWER}) && {ANSWER}"):
            lift(tab)
        return not latched.robot.state.estop

    wait_for("the reset", reset)
    time.sleep(STALL_S)
    lift(tab)
    tab.run("document.getElementById('reset').dispatchEvent(new MouseEvent('click', {bubbles: true}))")
    assert "cleared" in tab.run(ANSWER)

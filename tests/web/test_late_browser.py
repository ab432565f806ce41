"""What a page in a real browser says while its network is late or away. `make web` runs it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.late import Late
from tests.web.parts import Web

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

SETTINGS = '[attend]\nrequired = "on"\nlease_s = 1.0\n[web]\npairing = "on"\n'
IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
AWAY = 9
"""A port at which nobody answers."""
LATE_S = 2.0
WORD = "document.getElementById('word').textContent"
BUTTON = "document.getElementById('attend').textContent"
WHY = "document.getElementById('attend-why').textContent"


@pytest.fixture(scope="module")
def network(web: Web) -> Iterator[Late]:
    with Late(web.port) as running:
        yield running


@pytest.fixture(scope="module")
def tab(browser: Browser, web: Web, network: Late) -> Iterator[Tab]:
    """A phone that is paired, and sees the robot through this network; no script may throw."""
    found = browser.tab(f"{network.url}#{web.code()}")
    found.until("document.getElementById('code').value !== '' && !document.getElementById('pair').hidden")
    found.run("document.getElementById('device-name').value = 'Dora'")
    found.tap("#pair button")
    found.until("!document.getElementById('attendance').hidden")
    yield found
    assert found.errors == []


@pytest.mark.parametrize("way", ["down_s", "up_s"])
def test_a_state_that_comes_late_is_not_shown_as_the_present_one(network: Late, tab: Tab, way: str) -> None:
    """It comes all the time, but each message is seconds old, or the network may deliver this page's STOP as late."""
    tab.until(f"{WORD} === 'STOPPED'")
    setattr(network, way, LATE_S)
    tab.until(f"{WORD} === 'NO CONTACT'")
    tab.run(
        "window.words = []; new MutationObserver(() => words.push(document.getElementById('word').textContent))"
        ".observe(document.getElementById('word'), {childList: true, characterData: true, subtree: true})"
    )
    since_ms = tab.run("performance.now()")
    tab.until(f"performance.now() > {since_ms + 2e3 * LATE_S}", "messages that are all late")
    assert tab.run("words") == []
    assert "Last known: STOPPED" in tab.text("#why")
    assert tab.text("#speed") == tab.text("#shake") == "not known"
    setattr(network, way, 0.0)
    tab.until(f"{WORD} === 'STOPPED'")


def test_who_attends_without_a_connection_is_told_so(trial: Trial, web: Web, network: Late, tab: Tab) -> None:
    tab.until(f"{BUTTON} === 'ATTEND'")
    network.to = AWAY
    network.cut()
    tab.until(f"{WORD} === 'NO CONTACT'")
    tab.tap("#attend")
    tab.until(f"{WHY}.includes('there is no connection')")
    assert tab.run(BUTTON) == "ATTEND"
    network.to = web.port
    tab.until(f"{WORD} === 'STOPPED'")  # by a plain request perhaps, which is no connection that attends
    tab.until(f"!{WHY}.includes('there is no connection')")
    assert tab.run(BUTTON) == "ATTEND"


def test_whose_answers_come_too_late_is_told_that_the_robot_does_not_count_them(
    trial: Trial, network: Late, tab: Tab
) -> None:
    tab.tap("#attend")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Dora",))
    tab.until(f"{BUTTON}.includes('ATTENDING')")
    network.up_s = 0.5  # the state is new enough, but of the robot's questions only the newest two count
    tab.until(f"{BUTTON}.includes('NOT COUNTED') && {WHY}.includes('does not count you')")
    assert trial.robot.state.attended_by == ()
    network.up_s = 0.0
    tab.until(f"{BUTTON}.includes('ATTENDING') && !{WHY}.includes('does not count you')")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Dora",))
    tab.tap("#attend")
    tab.until(f"{BUTTON} === 'ATTEND'")

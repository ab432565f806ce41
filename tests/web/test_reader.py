"""The page for a keyboard and a screen reader: the accessibility tree names everything, each act can be done without a
pointer, and what matters is announced while what changes all the time is not. Needs chromium: `make web`."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from failstop_lab.trial import Trial, TrialError, wait_for
from tests.web.browser import CHROMIUM, Browser, Tab
from tests.web.parts import Web, driven

pytestmark = [pytest.mark.page, pytest.mark.skipif(not CHROMIUM, reason="no chromium: make web installs it")]

SETTINGS = '[attend]\nrequired = "on"\nlease_s = 2.0\n[web]\npairing = "on"\n'
ENTER = ("Enter", "Enter", 13)
TAB = ("Tab", "Tab", 9)
SPACE = (" ", "Space", 32)
CONTROLS = ("button", "textbox", "link", "DisclosureTriangle", "checkbox", "slider")
MOST_TABS = 60
WORD = "document.getElementById('word').textContent"
SPOKEN = "document.getElementById('spoken').textContent"
LIVE = "[role=status], [role=alert], [role=log], [role=timer], [aria-live]:not([aria-live=off]), output"
QUIET_PARTS = 10
"""Changes of the live values, in which nothing is announced."""
DRAWN_MS = 390.0
"""The least time between two of them, which the page draws every 0.4 s at most."""


@pytest.fixture(scope="module")
def tab(web: Web) -> Iterator[Tab]:
    """A desk without a mouse; no script may throw."""
    with Browser() as browser:
        found = browser.tab(web.url.replace("127.0.0.1", "localhost"), wide=1280, high=800, touch=False)
        found.until(f"{WORD} !== 'CONNECTING'")
        yield found
        assert found.errors == []


def nodes(tab: Tab) -> list[dict[str, Any]]:
    """Role, name, description and properties of what a screen reader finds, in its order."""
    rows = tab.call("Accessibility.getFullAXTree")["nodes"]
    return [
        {
            "role": row.get("role", {}).get("value", ""),
            "name": row.get("name", {}).get("value", ""),
            "description": row.get("description", {}).get("value", ""),
            **{each["name"]: each["value"].get("value") for each in row.get("properties", ())},
        }
        for row in rows
        if not row["ignored"]
    ]


def focused(tab: Tab) -> dict[str, Any]:
    return next((row for row in nodes(tab) if row.get("focused") and row["role"] != "RootWebArea"), {"name": ""})


def go_to(tab: Tab, name: str) -> dict[str, Any]:
    """Press the tabulator until a control of that name has the focus."""
    seen = []
    for _ in range(MOST_TABS):
        tab.key(*TAB)
        found = focused(tab)
        if str(found["name"]).startswith(name):
            return found
        seen.append(found["name"])
    raise AssertionError(f"no way to {name!r} by the tabulator: {seen}")


def type_in(tab: Tab, name: str, text: str) -> None:
    assert go_to(tab, name)["role"] == "textbox"
    tab.call("Input.insertText", text=text)


def press(tab: Tab, name: str) -> None:
    go_to(tab, name)
    tab.key(*ENTER)


@contextlib.contextmanager
def held(tab: Tab, name: str) -> Iterator[None]:
    """Enter, down on that button."""
    go_to(tab, name)
    lift = tab.hold_key(*ENTER)
    try:
        yield
    finally:
        lift()


def hold(tab: Tab, name: str, what: str, check: Callable[[], object]) -> None:
    """Hold Enter on a button until it has worked; again where the page asks for that, as on a busy machine."""
    for _ in range(5):
        with held(tab, name), contextlib.suppress(TrialError):
            wait_for(what, check, 5)
            return
    raise AssertionError(f"no way to {what}: {tab.text('#answer')}")


def wait_until_free(tab: Tab, button: str) -> None:
    tab.until(f"document.getElementById('{button}').getAttribute('aria-disabled') === 'false'")


def test_every_control_has_a_name_and_stop_says_what_it_does(tab: Tab) -> None:
    found = nodes(tab)
    assert {"banner", "main", "contentinfo"} <= {row["role"] for row in found}
    wait_for(  # the service has just been started, so the word may change between the two questions
        "the word to be the heading",
        lambda: (
            [row["name"] for row in nodes(tab) if row["role"] == "heading" and row["level"] == 1] == [tab.run(WORD)]
        ),
    )
    assert [row for row in found if row["role"] in CONTROLS and not row["name"]] == []
    (stop,) = [row for row in found if row["role"] == "button" and row["name"] == "STOP"]
    assert "Space or Escape" in stop["description"]


def test_what_is_announced_is_a_short_list(tab: Tab) -> None:
    ids = tab.run(f"[...document.querySelectorAll({LIVE!r})].map((part) => part.id)")
    assert sorted(ids) == ["alarm", "answer", "drive-why", "pair-why", "spoken"]


def test_a_pairing_without_a_pointer(web: Web, tab: Tab) -> None:
    press(tab, "Pair this device")
    type_in(tab, "Code that", web.code())
    type_in(tab, "Name of this device", "Anna")
    press(tab, "Pair")
    tab.until("!document.getElementById('buttons').hidden")


def test_an_operator_attends_limits_enables_and_disables_without_a_pointer(trial: Trial, tab: Tab) -> None:
    press(tab, "ATTEND")
    wait_for("the operator", lambda: trial.robot.state.attended_by == ("Anna",))
    assert focused(tab)["pressed"] in (True, "true")
    press(tab, "25 percent")
    wait_for("the limit", lambda: trial.robot.state.speed_limit == 0.25)
    wait_until_free(tab, "enable")
    hold(tab, "ENABLE", "enable motion", lambda: trial.robot.state.enabled)
    tab.until(f"{SPOKEN}.startsWith('CAN MOVE')")
    press(tab, "DISABLE")
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)
    tab.until(f"{SPOKEN}.startsWith('TOLD TO STOP')")


def test_enter_that_is_let_go_enables_nothing(trial: Trial, tab: Tab) -> None:
    wait_until_free(tab, "enable")
    with held(tab, "ENABLE"):
        tab.until("document.getElementById('enable').classList.contains('held')")
    tab.until("!document.getElementById('enable').classList.contains('held')")
    assert not trial.robot.state.enabled


@pytest.mark.parametrize("key", [ENTER, SPACE], ids=["enter", "space"])
def test_stop_and_reset_without_a_pointer(trial: Trial, tab: Tab, key: tuple[str, str, int]) -> None:
    before = trial.robot.state.epoch
    go_to(tab, "STOP")
    tab.key(*key)
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    tab.until("document.getElementById('stop').getAttribute('aria-describedby') === 'stop-said'")
    tab.until("document.getElementById('stop-said').textContent.includes('written')")
    wait_until_free(tab, "reset")
    hold(tab, "RESET", "reset", lambda: not trial.robot.state.estop)


def test_space_on_any_button_is_stop_and_nothing_else(trial: Trial, tab: Tab) -> None:
    before = trial.robot.state.epoch
    go_to(tab, "ATTEND")
    pressed = tab.run("document.getElementById('attend').getAttribute('aria-pressed')")
    tab.key(*SPACE)
    wait_for("the stop", lambda: trial.robot.state.epoch > before)
    assert tab.run("document.getElementById('attend').getAttribute('aria-pressed')") == pressed


def click_stop(trial: Trial, tab: Tab, detail: int) -> None:
    before = trial.robot.state.epoch
    tab.run(f"document.getElementById('stop').dispatchEvent(new MouseEvent('click', {{detail: {detail}}}))")
    wait_for("the stop", lambda: trial.robot.state.epoch > before)


def test_a_readers_click_stops_and_disables_and_is_told_how_to_hold(trial: Trial, tab: Tab) -> None:
    """An assistive program presses a button so: a click without a finger, whatever number it bears."""
    tab.until("document.getElementById('reset').getAttribute('aria-disabled') === 'false'")
    tab.run("document.getElementById('reset').click()")
    tab.until("document.getElementById('answer').textContent.includes('with Enter')")
    assert trial.robot.state.estop
    for detail in (0, 1):
        click_stop(trial, tab, detail)
    hold(tab, "RESET", "reset", lambda: not trial.robot.state.estop)
    wait_until_free(tab, "enable")
    hold(tab, "ENABLE", "enable motion", lambda: trial.robot.state.enabled)
    tab.until("document.getElementById('disable').getAttribute('aria-disabled') === 'false'")
    tab.run("document.getElementById('disable').click()")
    wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)


WATCH = f"""
(() => {{
  window.said = [];
  window.changes = [];
  const note = (records) => said.push(...records.map(({{target}}) => (target.closest || (() => target.parentElement
    && target.parentElement.closest({LIVE!r}))).call(target, {LIVE!r})?.id));
  for (const part of document.querySelectorAll({LIVE!r})) {{
    new MutationObserver(note).observe(part, {{childList: true, characterData: true, subtree: true}});
  }}
  const shake = document.getElementById("shake");
  const count = () => {{ if (shake.textContent.endsWith("mrad/s")) window.changes.push(performance.now()); }};
  new MutationObserver(count).observe(shake, {{childList: true, subtree: true}});
}})()"""


def test_nothing_is_announced_ten_times_a_second(trial: Trial, tab: Tab) -> None:
    wait_until_free(tab, "enable")
    with driven(trial):
        hold(tab, "ENABLE", "move", lambda: trial.robot.state.moving)
        tab.until(f"{SPOKEN}.startsWith('MOVING')")
        tab.run(WATCH)
        tab.until(f"window.changes.length > {QUIET_PARTS}", timeout_s=30)
        assert tab.run("window.said") == []
        drawn = tab.run("window.changes")
        gaps_ms = [after - before for before, after in itertools.pairwise(drawn)]
        assert min(gaps_ms) > DRAWN_MS, "a finger on STOP waits for what is being drawn"
        press(tab, "STOP")
        tab.until(f"{SPOKEN}.startsWith('TOLD TO STOP.') && {SPOKEN}.includes('Anna')")


def test_a_stop_that_is_not_written_is_an_alert(trial: Trial, web: Web, tab: Tab) -> None:
    os.kill(web.process.pid, 19)
    try:
        press(tab, "STOP")
        tab.until("document.getElementById('alarm').textContent.includes('NOT WRITTEN')")
        rows = tab.call("Accessibility.getFullAXTree")["nodes"]
        (alarm,) = [row for row in rows if row.get("role", {}).get("value") == "alert" and row.get("childIds")]
        said = [row["name"]["value"] for row in rows if row["nodeId"] in alarm["childIds"] and "name" in row]
        assert any("POWER SWITCH" in line for line in said)
        tab.run("window.alarms = 0")
        tab.run(
            "new MutationObserver(() => { window.alarms++; })"
            ".observe(document.getElementById('alarm'), {childList: true})"
        )
        tab.until("document.getElementById('word').textContent === 'NO CONTACT'")
        tab.until(f"{SPOKEN}.startsWith('NO CONTACT')")
        assert tab.run("window.alarms") <= 2, "it is said once, and not at every try"
    finally:
        os.kill(web.process.pid, 18)
    tab.until("document.getElementById('alarm').textContent === ''")


def test_a_new_incident_leaves_the_focus_where_it_is(trial: Trial, tab: Tab) -> None:
    tab.until("document.querySelector('.card') !== null", "an incident", 30)
    go_to(tab, "stop request")
    tab.run("window.had = document.activeElement")
    before = tab.run("document.querySelectorAll('.card').length")
    trial.enable()
    trial.robot.estop("one more")
    tab.until(f"document.querySelectorAll('.card').length > {before}", "a new incident", 30)
    assert tab.run("document.activeElement === window.had")


def test_an_incident_and_the_end_of_the_pairing_without_a_pointer(tab: Tab) -> None:
    tab.until("document.querySelector('.card') !== null", "an incident", 30)
    press(tab, "stop request")
    tab.until("document.activeElement.closest('.card').open")
    go_to(tab, "Events")
    press(tab, "Forget this device")
    tab.until("document.getElementById('buttons').hidden")

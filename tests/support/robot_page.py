"""A row of the fault table on the page with the robot in it, judged by the board's wheels and what went out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from failstop.policy.causes import CAUSE_BY_NAME, Cause
from failstop_lab.browser.acts import ROWS, TENTH
from failstop_lab.faults.fault import BY_ITSELF, BY_NEW_RUN, BY_RESET, PROCESS_DIES, PROCESS_HANGS, SEVERAL, Fault, fits
from failstop_lab.faults.table import FAULT_BY_NAME

SEEN = 8
"""Steps in which a stop must have come: the longest row is silent for 0.525 s first."""
MOST = 60
ZEROS = "every wheel to zero"


class Page(Protocol):
    """The page, by its buttons: press one; let a tenth of a second pass; what it shows."""

    def press(self, act: str) -> None: ...
    def step(self) -> None: ...
    def shown(self) -> dict[str, Any]: ...


def until(page: Page, what: str, check: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    for _ in range(MOST):
        if check(shown := page.shown()):
            return shown
        page.step()
    raise AssertionError(f"waited {MOST / 10:g} s for {what}: {page.shown()}")


def moves(shown: dict[str, Any]) -> bool:
    return shown["view"]["word"] == "MOVING" and any(shown["wheels"]) and shown["wire"][-1][2] == "motion"


def stands(shown: dict[str, Any]) -> bool:
    return not any(shown["wheels"]) and shown["wire"][-1][2] == ZEROS


def cause_of(shown: dict[str, Any]) -> Cause | None:
    if (told := shown["cause"]) is None:
        return None
    return CAUSE_BY_NAME[told["name"]](*told["arguments"])


def enable(page: Page) -> None:
    if moves(page.shown()):
        return
    until(page, "an enable to be possible", lambda shown: shown["view"]["can"]["enable"] == "")
    page.press("enable")
    until(page, "motion", moves)


def play(page: Page, name: str) -> None:
    """Drive, make the fault of a row by clicking, and compare all that the row says; then what clears it."""
    row = FAULT_BY_NAME[name]
    enable(page)
    struck = page.shown()["time"]
    for act in ROWS[name]:
        page.step() if act == TENTH else page.press(act)
    for _ in range(SEEN):
        page.step()
    shown = page.shown()
    if row.bar_ms is None:
        assert moves(shown), shown
        assert cause_of(shown) is None
        return
    assert stands(shown), shown
    if row.event in (PROCESS_DIES, PROCESS_HANGS, SEVERAL):
        writer = next(who for at, who, what, *_ in shown["wire"] if what == ZEROS and at >= struck)
        assert writer.replace("_", " ") in row.first.replace("_", " "), (writer, row.first)
    if row.latched:
        assert fits(cause_of(shown), row.latched), (shown["cause"], row.latched)
    if row.survives:  # a supervisor that hangs is systemd's to end
        for switch in [switch for switch, on in shown["on"].items() if not on]:
            page.press(switch)
    clear(page, row)


def clear(page: Page, row: Fault) -> None:
    """The wheels turn again by what the row says, and not before."""
    if row.cleared == BY_ITSELF:
        until(page, "motion by itself", moves)
        return
    if row.cleared == BY_RESET:
        page.press("enable")
        page.step()
        assert stands(page.shown())
        until(page, "a reset to be possible", lambda shown: shown["view"]["can"]["reset"] == "")
        page.press("reset")
    elif row.cleared == BY_NEW_RUN:
        until(page, "a new run", lambda shown: shown["view"]["can"]["enable"] == "" and not shown["cause"])
    for _ in range(SEEN):
        page.step()
    shown = page.shown()
    assert stands(shown), shown
    assert shown["cause"] is None, shown["cause"]
    enable(page)

"""A board that says nothing any more, or hears nothing: told, stopped for while motion is enabled, and not enabled
again before it is heard. The judge is what the board's wheels do; the service runs on the simulated machine."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.boards.traits import HAS_REPORTS, SHOWS_DEAF, traits_of
from tests.support.boards import own_folder
from tests.support.pages import ROOT
from tests.support.simulated import Simulated

TOLD_S = 1.0
PINGED_S = 1.5
"""A ping every 0.5 s, none of which was answered for 1 s (link.deaf_s)."""
ECHO_FADES_S = 0.8
"""Its own watchdog sets the command to zero so long after the last frame; only then does its echo say zero."""
SILENT = [kind for kind in BOARDS if HAS_REPORTS in traits_of(kind).parts]
DEAF = [kind for kind in BOARDS if SHOWS_DEAF in traits_of(kind).parts]
SEEN_S = 3.0
"""How long a board of which no period is known is watched first."""


def made(kind: str) -> Simulated:
    service = Simulated(kind=kind)
    service.wait(SEEN_S)
    return service


def lasts(service: Simulated, check: Callable[[], object], timeout_s: float = 5.0) -> float:
    """Drive until it holds; how long that was, s."""
    begun_ns = service.now_ns()
    while not check():
        assert service.now_ns() - begun_ns < timeout_s * 1e9, f"not within {timeout_s:g} s"
        service.drive(0.02)
    return (service.now_ns() - begun_ns) / 1e9


@pytest.mark.claim("SILENCE-1")
@pytest.mark.parametrize("kind", SILENT)
def test_a_board_that_falls_silent_while_it_drives_is_stopped(kind: str) -> None:
    service = made(kind)
    service.set_off()
    service.board.silent(True)
    assert lasts(service, lambda: service.robot.state.cause) <= TOLD_S
    state = service.robot.state
    assert (state.cause.kind.name, state.device.link) == ("board_silent", "silent")
    service.wait(1.0)
    assert not service.turning(), "it still hears"
    service.robot.reset()
    with pytest.raises(service.failstop.Refused, match="says nothing"):
        service.robot.enable()
    service.board.silent(False)
    service.wait(1.0)
    assert service.robot.state.device.link != "silent"
    service.drive(0.3)
    assert not service.turning(), "nobody has enabled motion"
    service.set_off()


@pytest.mark.parametrize("kind", DEAF)
def test_a_board_that_hears_nothing_does_not_drive_off_when_it_hears_again(kind: str) -> None:
    service = made(kind)
    service.set_off()
    service.board.deaf(True)
    told_s = lasts(service, lambda: service.robot.state.cause)
    assert told_s <= (ECHO_FADES_S if kind == "hoverboard" else PINGED_S) + 0.1
    assert service.robot.state.cause.kind.name == "deaf"
    service.drive(4.0)
    service.board.deaf(False)
    service.drive(2.0)
    assert not service.turning()


@pytest.mark.parametrize("kind", SILENT)
def test_a_silent_board_is_told_while_motion_is_disabled_and_latches_nothing(kind: str) -> None:
    service = made(kind)
    service.board.silent(True)
    service.wait(TOLD_S)
    state = service.robot.state
    assert (state.device.link, state.cause) == ("silent", None)
    with pytest.raises(service.failstop.Refused, match="says nothing"):
        service.robot.enable()
    service.wait(2.0)
    assert service.robot.state.cause is None


@pytest.mark.parametrize("kind", BOARDS)
def test_a_healthy_board_is_neither(kind: str) -> None:
    service = made(kind)
    service.set_off()
    for _ in range(4):
        service.drive(3.0)
        assert service.robot.state.cause is None
        service.robot.disable()
        service.wait(6.0)
        assert service.robot.state.device.link in ("alive", "unasked")
        service.enable()


@pytest.mark.parametrize("kind", SILENT)
def test_every_screen_says_so_and_how_old_its_readings_are(kind: str) -> None:
    service = made(kind)
    battery = service.robot.state.battery_v
    service.board.silent(True)
    service.wait(4.0)
    state = service.robot.state
    assert 3.9 < state.ages.board_s < 4.2
    shown = " ".join(service.command("status")[1].split())
    assert shown.startswith("wheels MAY TURN")
    assert "link silent" in shown
    view = service.load("failstop.web.view").view(state, [], 0.0)
    assert view["word"] == "WHEELS MAY TURN"
    assert "says NOTHING" in view["board"]
    told = service.json("why")
    assert "has said nothing for" in str(told)
    families = {family.name: samples for family, samples in service.load("failstop.fleet.metrics").collect(state)}
    assert dict(families["failstop_link_state"])[(("state", "silent"),)] == 1.0
    assert dict(families["failstop_reading_age_seconds"])[(("reading", "board"),)] == state.ages.board_s
    rows = {row["name"]: row for row in service.load("failstop.ros2.diagnostics").statuses("f", state, "", [], [])}
    assert rows["f: link"]["level"] == 2
    if battery:
        assert re.search(r"V.*, [45]\.\d s ago", shown)
        assert view["battery_age"].endswith(" s ago")
        assert rows["f: battery"]["level"] == 3


def hoverboards_without_reports(at: Path) -> str:
    """A hoverboard as a board of one's own, whose description does not say how often it reports."""
    folder = own_folder(at)
    for name, source in {
        "codec": "failstop/board/hoverboard/codec.py",
        "driver": "failstop/board/hoverboard/driver.py",
        "feedback": "failstop/board/hoverboard/feedback.py",
        "wire": "failstop/board/hoverboard/wire.py",
        "receiver": "lab/failstop_lab/boards/hoverboard.py",
    }.items():
        text = (ROOT / source).read_text()
        text = text.replace("from failstop.board.hoverboard import", "from . import")
        text = text.replace("from failstop.board.hoverboard.", "from .")
        if name == "wire":
            text = text.replace("_MS = 1_000_000\n", "_MS = 1_000_000\nVOCABULARY = 1\n", 1)
            text, count = re.subn(r"(?m)^    reports=Reports\(.*?^    \),\n", "", text, flags=re.DOTALL)
            assert count == 1
        (at / f"{name}.py").write_text(text)
    return folder


@pytest.mark.starts
def test_an_own_board_is_judged_by_what_was_seen_of_it(tmp_path: Path) -> None:
    service = made(hoverboards_without_reports(tmp_path / "own"))
    service.set_off()
    service.board.silent(True)
    assert lasts(service, lambda: service.robot.state.cause) <= TOLD_S
    assert service.robot.state.cause.kind.name == "board_silent"

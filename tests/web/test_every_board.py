"""The page at every board: it shows what the board reports, and its STOP stops the wheels, by the receiver's word."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from failstop.api import verdict
from failstop.board.interface import BY_WHEELS
from failstop.board.kinds import KINDS
from failstop_lab.boards.traits import HAS_PINGS, traits_of
from failstop_lab.trial import Trial, judge, wait_for
from tests.support.amounts import LONG
from tests.support.boards import EVERY_KIND
from tests.support.leases import LEASES
from tests.web.parts import Web, driven

IN_SHORT = ("hoverboard", *EVERY_KIND[len(KINDS) :])
"""In each commit the board that answers no question, and one of one's own."""


@pytest.mark.slow
@pytest.mark.starts
@pytest.mark.parametrize("kind", EVERY_KIND if LONG else IN_SHORT)
def test_a_stop_on_the_page_stops_every_board_and_shows_its_proofs(kind: str, tmp_path: Path) -> None:
    traits, name, settings = traits_of(kind), f"web-{os.getpid()}-board", tmp_path / "failstop.toml"
    settings.write_text(LEASES + f'board.kind = "{kind}"\n')
    with Trial(name, ("--config", str(settings)), kind=kind) as trial, Web(name, state=trial.state) as web:

        def view() -> Any:
            return web.get("/api/state")["view"]

        trial.enable()
        with driven(trial):
            wait_for("the wheels to turn", trial.turning)
            if traits.language.observed_by == BY_WHEELS:  # a hoverboard reports no speed below 5.3 rpm
                wait_for("the board to report it", lambda: trial.robot.state.turning.does == "turning")
            answers = (
                "The board answers." if HAS_PINGS in traits.parts else "This board answers no questions, by design."
            )
            assert web.until("MOVING")["board"] == answers
            trial.board.events()
            moving, asked_ns = trial.turning(), time.monotonic_ns()
            status, said = web.post("/api/stop")
            assert (status, said["written"], moving) == (200, True, True)
            # Of a stop the page says no more than is proved.
            proves = traits.language.acknowledged_by or traits.language.observed_by == BY_WHEELS
            assert web.until(verdict.STOPPED if proves else verdict.WRITTEN)["stop"]["written"]
        seen = judge(trial.board.events(), asked_ns, moving)
        assert seen.stop_ns is not None
        assert seen.motion_after == 0
        assert not trial.turning()
        if traits.language.acknowledged_by:
            wait_for("the board's acknowledgement", lambda: view()["stop"]["acknowledged"])
        if traits.language.observed_by == BY_WHEELS:
            wait_for("the wheels' word", lambda: view()["stop"]["observed"].startswith("still after"))

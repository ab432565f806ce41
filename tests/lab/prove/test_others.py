"""A test on a stand ends when somebody else stops the robot: it does not reset that stop, and does not drive again."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from failstop.api.client import send_stop
from failstop_lab.prove import session
from failstop_lab.prove.others import StoppedByOthers
from failstop_lab.prove.run import PathRun
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import BY_PATH, BY_TURNING
from failstop_lab.sim.client import SimBoard
from tests.lab.prove.noise import SIMULATED
from tests.lab.prove.stands import LEASE, on_stand


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before the test's own stop", "behind it", "between two rows"])
def test_a_person_s_stop_ends_the_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
    rows = [(BY_PATH["stop-request"], BY_TURNING["0.2"], random.Random()) for _ in range(2)]
    asked: list[int] = []
    with SimBoard(tmp_path / "board") as board:
        stand = ProveStand(board.link, LEASE, str(tmp_path), board)

        def person() -> None:
            if not asked:
                asked.append(len(seen))
                send_stop(stand.name, "hand near a wheel")

        def each() -> None:
            if when == "before the test's own stop" and max(map(abs, board.wheels())) > 0.7:
                person()
            stand.look()

        strike = PathRun._strike

        def struck(run: PathRun) -> int:
            found = strike(run)
            if when == "behind it":
                stand.driver.until("the test's own stop", lambda: stand.driver.robot.state.cause is not None)
                person()
            return found

        stand.driver.each = each
        monkeypatch.setattr(PathRun, "_strike", struck)
        monkeypatch.setattr(session, "_characterize", lambda *_, **__: SIMULATED)
        seen: list[str] = []

        def say(line: str) -> None:
            seen.append(line)
            if when == "between two rows" and "stop-request" in line and stand.service.process:
                person()

        found = session.session(rows, [BY_TURNING["0.2"]], stand, say=say)
        moved = [event for event in board.events() if event.is_motion]
    assert asked
    assert "hand near a wheel" in found.ended
    assert found.verdict != "PASS"
    assert len(found.results) == (2 if when == "between two rows" else 1)
    if when == "between two rows":
        assert not moved, "the second row does not drive"


@pytest.mark.slow
def test_it_ends_at_a_button_that_no_row_asks_for_but_not_at_its_own_stop(tmp_path: Path) -> None:
    with on_stand(tmp_path) as stand:
        stand.driver.enable()
        stand.ask("prove")
        stand.driver.until("the test's own stop", lambda: stand.driver.robot.state.cause is not None)
        stand.driver.enable()
        assert stand.board
        stand.driver.commands = False
        stand.board.key(1, 1)
        stand.driver.until("the key's stop", lambda: stand.driver.robot.state.cause is not None)
        cause = stand.driver.robot.state.cause
        with pytest.raises(StoppedByOthers, match="key1"):
            stand.driver.enable()
        assert stand.driver.robot.state.cause == cause, "it is not reset"

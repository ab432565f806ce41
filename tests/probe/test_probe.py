"""The probe against simulated boards: its card says what the board did, and its death leaves no wheel turning."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import threading
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from failstop.board.kinds import board_of
from failstop.lab.boards.live import DIAMETER_M
from failstop.lab.probe import judge
from failstop.lab.probe.card import FORMATS, Card, Row
from failstop.lab.probe.serial import ROWS, SerialProbe, frame_of
from failstop.lab.sim.client import SimBoard
from tests.support.amounts import LONG, amount
from tests.support.commands import FAILSTOP, failstop

T13 = b'{"T":13,"X":0.1,"Z":0}\n'
ALONE = [name for name in ROWS if name != "plug"]
BASES = {"hoverboard": None, "ugv": None, "arduino": None, "rrc": None, "ugv by T:13": T13}
"""Each kind of board, and what its driver sends where that is not the usual frame."""
NEAR_S = 0.5
"""Functional: how exact it is on a quiet machine is measured elsewhere."""
MOVES_S, STOPS_S = 40.0, 40.0


class Watched:
    """When the wheels of a simulated board came to rest, by its own word, while a block runs."""

    def __init__(self, board: SimBoard) -> None:
        self._board, self._over = board, threading.Event()
        self.rests: list[int] = []
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> Watched:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        turned = False
        while not self._over.wait(0.005):
            turns = any(self._board.wheels())
            if turned and not turns:
                self.rests.append(time.monotonic_ns())
            turned = turns

    def after_s(self, cause_ns: int) -> float:
        """From a cause to the first rest."""
        return next(rest - cause_ns for rest in self.rests if rest >= cause_ns) / 1e9


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES if LONG else ["hoverboard"])
def test_the_card_says_what_the_board_did(base: str, tmp_path: Path) -> None:
    kind, sent = base.split()[0], BASES[base]
    with SimBoard(tmp_path / "b", board=kind) as board, Watched(board) as watched:
        language = board_of(kind, DIAMETER_M, 0.0)
        frame = sent or frame_of(language)
        with SerialProbe(board.link, kind, language, frame, by_key=False, say=pytest.fail) as probe:
            probe.character()
            rows = [probe.take(name) for name in (ALONE if LONG else ["silence"])]
        board.wait_wheels(False, STOPS_S)
    for row in rows:
        really_s = watched.after_s(row.cause_ns)
        print(base, row.name, row.found, f"really {really_s:.3f}")
        if really_s >= judge.NEVER_S:
            assert row.stands_s is None
        else:
            assert row.stands_s == pytest.approx(really_s, abs=NEAR_S)


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(amount(1, 10)))
def test_a_probe_that_is_killed_leaves_no_wheel_turning(draw: int, tmp_path: Path) -> None:
    """The board is one that keeps its last speed forever: nobody else stops it."""
    words = ["probe", "serial", "--board", "rrc", "--port", str(tmp_path / "b"), "--yes", "--rows", "silence,sigkill"]
    with SimBoard(tmp_path / "b") as board:
        with open(tmp_path / "log", "w") as log:
            probe = subprocess.Popen(
                [*FAILSTOP, *words, "--out", str(tmp_path / "card")], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        board.wait_wheels(True, MOVES_S)
        time.sleep(random.Random(draw).uniform(0.0, 8.0) if draw else 0.0)
        probe.send_signal(signal.SIGKILL)
        probe.wait()
        # Its driver may be between two frames, and the watcher between two stops: at rest is what stays so.
        board.wait_for(lambda event: event.is_stop and not event.is_motion, STOPS_S)
        board.wait_wheels(False, STOPS_S)


def test_the_judge_dates_a_rest_by_its_first_report() -> None:
    turning = [(at, (0.1, 0.1), (float(at), float(at))) for at in range(5)]
    rests = [(at, (0.0, 0.0), (4.0, 4.0)) for at in range(5, 9)]
    assert judge.rest_ns([*turning, *rests]) == 5
    assert judge.rest_ns(turning) is None
    assert judge.rest_ns([(at, (), (float(at // 3),)) for at in range(9)]) == 6
    assert judge.rest_ns([]) is None


def test_a_card_is_a_text_of_80_columns_a_picture_and_json(tmp_path: Path) -> None:
    rows = [Row("sigkill", ROWS["sigkill"], None, judge.OWN_WORD), Row("silence", ROWS["silence"], 0.8, judge.PERSON)]
    card = Card("a <robot> & more " * 9, "ugv", "", "mine", [*rows, Row("plug", ROWS["plug"], skipped="nobody")])
    texts, data, picture = (Path(path) for path in card.save(str(tmp_path / "card")))
    assert tuple(path.suffix for path in (texts, data, picture)) == FORMATS
    assert {len(line) for line in texts.read_text().splitlines()} == {80}
    assert "NOT stop in 1 of 2" in card.verdict
    assert "never" in picture.read_text()
    ElementTree.fromstring(picture.read_text())
    assert [row["never"] for row in json.loads(data.read_text())["rows"]] == [True, False, False]


def test_wrong_options_are_told() -> None:
    done = failstop("probe", "serial", "--port", "/nowhere", "--board", "ugv")
    assert done.returncode == 1
    assert "no port /nowhere: plug the board in" in done.stderr
    assert "no row 'nap'" in failstop("probe", "serial", "--port", "/nowhere", "--board", "ugv", "--rows", "nap").stderr

"""The row in which the whole service is frozen: what it must call wrong, without a stand; nothing stays frozen."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.board.interface import BY_ANSWER, BY_ECHO, BY_WHEELS
from failstop.board.kinds import KINDS, board_of
from failstop.board.wire import COAST, ZERO
from failstop_lab.prove import table
from failstop_lab.prove.frozen import EARLY_S, NOT_STOPPED, FrozenRun
from failstop_lab.prove.means import NEVER_ACTS, NO_ANSWER, NO_PAD, NO_REPORTS, UNMEASURED, Means, means_of
from failstop_lab.prove.run import Result
from failstop_lab.prove.sight import ByWheels, SeenSample, Unseen, longest_gap_s, rest_ns, rests
from failstop_lab.prove.table import BY_PATH, BY_TURNING, PATHS
from failstop_lab.trial import wait_for
from tests.lab.prove.judged import MEANS, MS
from tests.support.board_events import FAULT_NS

PATH, VELOCITY = BY_PATH[table.FROZEN], BY_TURNING["0.2"]
SIGHT = ByWheels(gap_s=0.05, rolled_s={"0.2": 0.1})
BOARD = Means(BY_ECHO, BY_WHEELS, watchdog_s=1.0, does=ZERO)
WITHIN_S = 0.9
"""From the freeze to wheels at rest, where all is well."""


def reports(stops_s: float, until_s: float = 3.0, speed: float = 0.2) -> list[SeenSample]:
    """Every 50 ms, from a second before the freeze on."""
    times = [-1.0 + 0.05 * number for number in range(round((until_s + 1.0) / 0.05))]
    return [(FAULT_NS + round(t_s * 1000) * MS, (speed if t_s < stops_s else 0.0,) * 2, ()) for t_s in times]


def frozen(**changed: object) -> FrozenRun:
    """A run on a real board that reports its wheels and what it obeys, seen through to the end of the freeze."""
    zeros_ns = FAULT_NS + round(WITHIN_S * 1000) * MS
    watch = SimpleNamespace(samples=reports(WITHIN_S), written=[], obeys_zeros=[zeros_ns])
    for name, value in changed.items():
        setattr(watch, name, value)
    stand = SimpleNamespace(board=None, watch=watch, means=BOARD)
    made = FrozenRun(stand, SIGHT, BOARD.fitted(PATH), VELOCITY, None, random.Random(1))  # type: ignore[arg-type]
    made.cause_ns = FAULT_NS
    return made


def judged(made: FrozenRun) -> Result:
    made.judge()
    return made.result


def test_a_board_that_stops_its_wheels_in_time_passes() -> None:
    found = judged(frozen())
    assert (found.verdict, found.wrong) == ("PASS", [])
    assert found.rest_s == pytest.approx(WITHIN_S)
    assert found.acknowledged_ms == pytest.approx(WITHIN_S * 1000)


WRONG: dict[str, tuple[dict[str, object], bool]] = {
    NOT_STOPPED: ({"samples": reports(99.0)}, True),
    "the board's report of its wheels is silent": ({"samples": reports(99.0, until_s=-0.01)}, True),
    "the wheels were not seen turning before": ({"samples": reports(-9.0)}, False),
    "at rest after 1.90 s, the bar": ({"samples": reports(1.9)}, False),
    f"at rest after {1.0 - EARLY_S - 0.1:.2f} s: its own watchdog acts": ({"samples": reports(0.6)}, False),
    "gate wrote a stop": ({"written": [(FAULT_NS + MS, "gate")]}, False),
    "the board did not report that it obeys zero": ({"obeys_zeros": [FAULT_NS - MS]}, True),
    "its own watchdog acted after 1900 ms": ({"obeys_zeros": [FAULT_NS + 1900 * MS]}, False),
}


@pytest.mark.parametrize("what", WRONG)
def test_anything_else_is_wrong_and_a_starved_machine_excuses_times_alone(what: str) -> None:
    changed, firm = WRONG[what]
    found = judged(frozen(**changed))
    assert any(wrong.startswith(what) for wrong in found.wrong), found.wrong
    found.starved = "held"
    assert found.verdict == ("FAIL" if firm else "INVALID"), found.wrong


def test_a_board_of_positions_alone_stands_when_two_readings_are_equal() -> None:
    ways = [0.0, 5.0, 10.0, 14.0, 14.0, 14.0]
    samples = [(number * 100 * MS, (), (way, way)) for number, way in enumerate(ways)]
    assert rests(samples) == [(number * 100 * MS, number >= 4) for number in range(1, 6)]
    assert rest_ns(samples) == 400 * MS
    assert rest_ns(samples[:4]) is None
    assert longest_gap_s(samples) == pytest.approx(0.1)


def test_every_board_says_what_it_can_not_prove_and_has_the_rows_that_it_can() -> None:
    for kind in KINDS:
        means = means_of(kind, board_of(kind, 0.08, 0.0))
        freezes = means.watchdog_s > 0
        assert [path.name for path in PATHS if means.lacks(path)] == [table.PAD_STOP] + [table.FROZEN] * (not freezes)
        assert f"{table.PAD_STOP}: {NO_PAD}" in means.unproved()
        assert not freezes or means.fitted(PATH).reaction_ms == means.watchdog_s * 1000
        assert any(line.endswith("may roll on") for line in means.unproved()) is (means.does == COAST)
    first = means_of("rrc", board_of("rrc", 0.08, 0.0))
    assert first == MEANS
    assert [path.name for path in PATHS if first.lacks(path)] == [table.FROZEN]
    assert [line for line in first.unproved() if NEVER_ACTS in line] == [
        line for line in first.unproved() if line != UNMEASURED
    ]
    blind = means_of("rrc", board_of("rrc", 0.08, 0.0), imu=False)
    assert blind.may_be_blind
    assert NO_REPORTS in blind.unproved(blind=True)
    assert blind.lines()[0].endswith("wheels at rest are observed by nobody but you")


def test_a_board_that_says_nothing_is_told_of_and_nobody_claims_to_see_it() -> None:
    silent = Means("", BY_WHEELS, may_be_blind=True, watchdog_s=2.0, does=ZERO)
    assert {NO_REPORTS, NO_ANSWER} <= set(silent.unproved(blind=True))
    assert NO_REPORTS not in Means(BY_ANSWER, BY_WHEELS).unproved()
    assert Unseen().rest_bar_s(PATH, VELOCITY) == 0.0


FREEZES = """
import os, signal, sys
from failstop_lab.prove.frozen import Freeze
with Freeze([int(sys.argv[1])]):
    while open(f"/proc/{sys.argv[1]}/stat").read().rpartition(") ")[2][0] != "T":
        pass
    exec(sys.argv[2])
"""
GUARD_HANGS = (
    "[os.kill(int(p), signal.SIGSTOP) for p in open(f'/proc/self/task/{os.getpid()}/children').read().split()]"
)
SLEEPS = "import sys; open('/proc/self/comm', 'w').write('fs:test'); print(flush=True); sys.stdin.read()"


def state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0]


@pytest.mark.starts
@pytest.mark.parametrize(
    "ends",
    [
        "os.kill(os.getpid(), signal.SIGKILL)",
        "raise KeyboardInterrupt",
        "signal.raise_signal(signal.SIGINT)",
        f"{GUARD_HANGS}; raise KeyboardInterrupt",
    ],
)
def test_nothing_stays_frozen_however_the_test_ends(ends: str) -> None:
    with subprocess.Popen([sys.executable, "-c", SLEEPS], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin
        assert process.stdout
        process.stdout.readline()
        words = [sys.executable, "-c", FREEZES, str(process.pid), ends]
        done = subprocess.run(words, stderr=subprocess.DEVNULL, check=False, timeout=30)
        assert done.returncode
        wait_for("it to go on", lambda: state(process.pid) == "S")
        process.stdin.close()
        assert process.wait(10) == 0

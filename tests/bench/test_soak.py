"""The soak's own account must be true: how late it finds ticks, what it calls a false stop, when it fails."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bench import ticks
from failstop import FailstopError, Robot
from failstop.api.client import send_stop
from failstop.board.rrc.framing import MOTOR
from failstop_lab.sim.client import Event
from failstop_lab.sim.motors import Motors
from failstop_lab.trial import wait_for

ROOT = Path(__file__).resolve().parent.parent.parent
PERIOD_NS = 20_000_000
PATIENCE_S = 60.0
MS = 1_000_000
STOP = bytes.fromhex("0104000000000001000000000200000000030000 0000")
MOVE = bytes.fromhex("0104000000003f010000003f020000003f030000003f")


def event(arrival_ns: int, data: bytes = MOVE) -> Event:
    a, b, c, d = Motors().execute(data)
    return Event(0, arrival_ns, arrival_ns, MOTOR, data, (a, b, c, d))


def drive(seconds: float, late: dict[int, int], seed: int = 1) -> tuple[list[Event], list[int]]:
    """Events and commands of a drive; `late`: tick number -> ns. While a tick is late the gate answers no command."""
    dice = random.Random(seed)
    start_ns = 77 * 10**9
    end_ns = start_ns + round(seconds * 1e9)
    commands, arrivals, hung = [start_ns], [], list[tuple[int, int]]()
    place_ns, number = start_ns + 7 * MS, 0
    while place_ns < end_ns + 3 * PERIOD_NS:
        came_ns = place_ns + late.get(number, 0)
        if number in late:
            hung.append((place_ns - PERIOD_NS // 2, came_ns))
        arrivals.append(came_ns + dice.randrange(200_000, 300_000))
        place_ns = max(place_ns + PERIOD_NS, came_ns + PERIOD_NS // 2)
        number += 1
    while commands[-1] < end_ns:
        commands.append(commands[-1] + dice.randrange(15 * MS, 25 * MS))
        if not any(begin <= commands[-1] <= end for begin, end in hung):
            arrivals.append(commands[-1] + 100_000)
    return [event(t_ns) for t_ns in sorted(arrivals)], commands


def lateness(events: list[Event], commands: list[int]) -> list[int]:
    return [late for one in ticks.stretches(events, commands) for late in ticks.lateness_ns(*one, PERIOD_NS)]


@pytest.mark.parametrize("seed", range(5))
def test_ticks_in_time_are_found_in_time(seed: int) -> None:
    found = lateness(*drive(20.0, {}, seed))
    assert len(found) == pytest.approx(1000, abs=5)
    assert max(found) < 0.5 * MS


@pytest.mark.parametrize("late_ms", [3, 9, 12, 25, 47])
def test_late_ticks_are_found_as_late_as_they_were(late_ms: int) -> None:
    late = dict.fromkeys((100, 250, 251, 600), late_ms * MS)
    found = sorted(lateness(*drive(20.0, late)))
    assert [round(ns / MS) for ns in found[-4:]] == pytest.approx([late_ms] * 4, abs=1)
    assert found[-5] < 1 * MS, "the ticks after a late one are none themselves"


def test_a_busy_first_second_does_not_hide_the_rest() -> None:
    dice = random.Random(3)
    busy = {number: dice.randrange(1, 9) * MS for number in range(50)}
    late = {**busy, 300: 12 * MS}
    found = lateness(*drive(20.0, late))
    assert len(found) == pytest.approx(1000, abs=5)
    assert [round(ns / MS) for ns in sorted(found)[-1:]] == pytest.approx([12], abs=1)


def test_a_stop_ends_the_account_and_counts_as_the_tick_that_did_not_come() -> None:
    events, commands = drive(4.0, {})
    cut_ns = events[0].arrival_ns + 2 * 10**9
    events = [one for one in events if one.arrival_ns < cut_ns]
    found = lateness([*events, event(cut_ns + 60 * MS, STOP)], commands)
    assert len(found) == pytest.approx(104, abs=3)
    assert 39 * MS < found[-1] < 62 * MS, "it was due, and had not come when the stop did"
    assert max(found[:-1]) < 1 * MS


def test_what_was_not_commanded_is_not_late() -> None:
    events, commands = drive(6.0, {})
    begin_ns, end_ns = commands[0] + 2 * 10**9, commands[0] + 4 * 10**9
    commands = [t_ns for t_ns in commands if not begin_ns < t_ns < end_ns]
    events = [one for one in events if not begin_ns + 300 * MS < one.arrival_ns < end_ns]
    assert max(lateness(events, commands)) < 1 * MS


def driving(name: str) -> bool:
    try:
        with Robot(name) as robot:
            return robot.state.body_vel[0] != 0
    except FailstopError:
        return False


@pytest.mark.slow
def test_six_seconds_of_it_with_a_late_tick_and_a_stop_from_elsewhere(tmp_path: Path) -> None:
    out = tmp_path / "soak.json"
    command = [sys.executable, "-m", "bench.soak", "--minutes", "0.1", "--out", str(out)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        name = f"trial-{process.pid}"
        wait_for("the drive to be on", lambda: driving(name), PATIENCE_S)
        with Robot(name) as robot:
            gate = robot.state.processes["gate"].pid
            time.sleep(1.2)  # of undisturbed driving, to be late against
            os.kill(gate, signal.SIGSTOP)
            time.sleep(0.045)
            os.kill(gate, signal.SIGCONT)
            time.sleep(0.3)
            send_stop(name, "on purpose")
        said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    table = json.loads(out.read_text())
    assert all(row["measure"] in said for row in table["rows"])
    rows: dict[str, dict[str, Any]] = {row["measure"].split(",")[0]: row for row in table["rows"]}
    assert rows["the gate's ticks"]["numbers"]["ticks"] > 100
    assert rows["the gate's ticks"]["numbers"]["max_ms"] > 15
    stops = rows["stops that nobody asked for"]["numbers"]["stops"]
    assert stops
    assert any("on purpose" in reason or "gate hangs" in reason for _, reason in stops)
    assert rows["IMU frames lost between board and state"]["numbers"]["of"] > 300
    assert rows["IMU frames lost between board and state"]["met"]
    assert rows["memory of the whole service (PSS)"]["numbers"]["end"] > 1

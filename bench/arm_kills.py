"""Kills while the arm moves, beside kills while the wheels turn, of the same service and run: how much longer does the
wheels' stop take behind the arm's frames?"""

from __future__ import annotations

import random
from collections.abc import Callable

from bench import stats
from bench.carriers import Carriers
from bench.stats import Row
from failstop.board.servos import HELD_NS
from failstop_lab.faults import arm
from failstop_lab.faults.arm import ArmTrial, Rested
from failstop_lab.faults.arm_table import KILL, ROWS
from failstop_lab.trial import Stopped

BUS_MS = HELD_NS / 1e6
KILLS = {fault.process: fault for fault in ROWS if fault.what == KILL}


def measure(trial: ArmTrial, kills: int, seed: int, carriers: Carriers, say: Callable[[str], None]) -> list[Row]:
    """Each process `kills` times in both ways, in turn."""
    chance = random.Random(seed)
    driving: dict[str, list[Stopped]] = {process: [] for process in KILLS}
    moving: dict[str, list[Rested]] = {process: [] for process in KILLS}
    for turn in range(kills):
        for process, fault in KILLS.items():
            say(f"kills of the {process}, {turn + 1} of {kills}")
            trial.drive_pose()
            trial.enable()
            pid = trial.service.pids()[process]
            carriers.first()
            driving[process].append(trial.kill(process, chance.uniform(0.1, 0.2)))
            trial.recover(process, pid)
            trial.settle()
            carriers.first()
            moving[process].append(arm.strike(trial, fault))
    return [row for process in KILLS for row in rows_of(process, driving[process], moving[process])]


def rows_of(process: str, driving: list[Stopped], moving: list[Rested]) -> list[Row]:
    """To the execution of the stop: it is there that a servo's frame holds it up, behind its arrival."""
    alone = [stopped.executed_ns for stopped in driving if stopped.executed_ns is not None]
    behind = [round(rested.wheels_ms * 1e6) for rested in moving if rested.wheels_ms is not None]
    rest = [round(rested.rest_ms * 1e6) for rested in moving if rested.rest_ms is not None]
    wrong = [rested.wrong for rested in moving if rested.wrong]
    least = stats.timing(f"kill {process} while driving -> the wheels' stop executed", alone, p50_ms=None, p99_ms=None)
    bar_ms = round(least.numbers["p99_ms"] + BUS_MS, 2)
    found = stats.timing(
        f"kill {process} while the arm moves -> the wheels' stop executed", behind, p50_ms=None, p99_ms=bar_ms
    )
    found.bar += f": the row above + {BUS_MS:g} ms"
    bar_ms = KILLS[process].bar_ms
    counted = stats.count(f"kill {process} while the arm moves: not as its row says", len(wrong), len(moving))
    counted.result += f" {wrong}" if wrong else ""
    return [
        least,
        found,
        stats.timing(f"kill {process} while the arm moves -> every joint stands", rest, p50_ms=None, p99_ms=bar_ms),
        counted,
    ]

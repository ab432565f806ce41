"""A campaign on the stand: random stop paths at random velocities, process faults of the fault table among them.

On a real board nothing on its side of the wire can be asked for its frames. The judges are the board itself, which
answers a ping behind the stop, and its IMU, which shows the wheels come to rest and stay so while the commands go on.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence

from failstop_lab.faults import ptrace, table
from failstop_lab.faults.fault import SPIN, Fault
from failstop_lab.prove.run import Result
from failstop_lab.prove.table import BY_PATH, FROZEN, PAD_STOP, PATHS, TURNINGS, Path, Turning, of_fault

Draw = tuple[Path, Turning, random.Random]
WIDTH = 46


def _fit(row: Fault) -> bool:
    """Processes alone are struck, the service lives on, and prove has no path of its own for it."""
    alone = row.injector == "processes" and row.survives and not row.stop_tool and row.bar_ms is not None
    return alone and row.name not in BY_PATH and not (row.struck(SPIN) and ptrace.unfit())


def paths() -> dict[str, Path]:
    """Everything that can be done on a stand without a person, on any board, by name."""
    found = [path for path in PATHS if path.kind not in (PAD_STOP, FROZEN)]
    found += [of_fault(row) for row in table.TABLE if _fit(row)]
    return {path.name: path for path in found}


def draw(chosen: list[Path], index: int, seed: int, velocities: Sequence[Turning] = TURNINGS) -> Draw:
    """The run of this index of a campaign: the same for the same seed and paths."""
    chance = random.Random(f"{seed} {index}")
    return chance.choice(chosen), chance.choice(velocities), chance


def draws(
    chosen: list[Path],
    seed: int,
    until: Callable[[int], bool],
    first: int = 0,
    velocities: Sequence[Turning] = TURNINGS,
) -> Iterator[Draw]:
    """One after the other, until `until` (how many there were) is true."""
    index = first
    while not until(index - first):
        yield draw(chosen, index, seed, velocities)
        index += 1


def table_lines(results: list[Result]) -> list[str]:
    """Each path with how often it was taken, and p50 and max of its times."""
    by_path: dict[str, list[Result]] = {}
    for result in results:
        by_path.setdefault(result.path.name, []).append(result)
    head = f"{'stop path':<{WIDTH}} {'count':>5} {'failed':>6} {'acknowledged, ms':>18} {'at rest, s':>14}  (p50 / max)"
    lines = [head]
    for name, found in sorted(by_path.items()):
        failed = sum(result.verdict == "FAIL" for result in found)
        heard = _spread([r.acknowledged_ms for r in found], ".0f")
        still = _spread([r.rest_s for r in found], ".2f")
        lines.append(f"{name:<{WIDTH}} {len(found):>5} {failed:>6} {heard:>18} {still:>14}")
    return lines


def _spread(values: list[float | None], form: str) -> str:
    known = sorted(value for value in values if value is not None)
    if not known:
        return "-"
    return f"{known[(len(known) - 1) // 2]:{form}} / {known[-1]:{form}}"

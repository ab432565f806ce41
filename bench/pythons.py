"""`python -m bench.pythons /usr/bin/python3.11 PATH PATH`: this tree on several Pythons, on one machine in one run.

Each Python gets an environment of its own, with the same versions of the packages. They are visited in turn, and each
round begins with another one, so that what slows the machine for a while slows all of them. Each visit has a service of
its own and measures a little of everything (bench/visit.py). The others are compared with the first (bench/ratio.py).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bench import BenchError, beside, ratio, visit
from bench.report import progress
from failstop.doctor.machine import facts
from failstop.setup.ending import interruptible

IMPORTS = 5
"""Times that each visit imports failstop in a new interpreter."""
IMPORT = "import failstop"
MEASURE = "a new interpreter imports failstop"
Rounds = list[dict[str, beside.Said]]
"""What each round's visits told, by the name of the side."""


@interruptible()
def main(words: Sequence[str] | None = None) -> int:
    """Measure, print a table for each of the others; exit code 1 when one is slower, 2 when nothing was measured."""
    parser = argparse.ArgumentParser(prog="python -m bench.pythons", description=__doc__)
    add = parser.add_argument
    add("pythons", nargs="+", help="interpreters, as paths; the others are compared with the first")
    add("--kills", type=int, default=60, help="of each process, on each Python (default: 60)")
    add("--samples", type=int, default=60, help="of each latency, on each Python (default: 60)")
    add("--seconds", type=float, default=12, help="of driving, on each Python (default: 12)")
    few = f"of fewer than {ratio.LEAST_ROUNDS} nothing is said"
    add("--rounds", type=int, default=6, help=f"visits to each Python (default: 6, and {few})")
    add("--margin", type=float, default=0.1, help="what is slower by less is not (default: 0.1)")
    arguments = parser.parse_args(words)
    much = visit.Amounts(arguments.kills, 0, arguments.samples, arguments.seconds, 1)
    load = os.getloadavg()[0]
    try:
        with tempfile.TemporaryDirectory(prefix="failstop-pythons-", dir="/var/tmp") as folder:
            sides = [side(python, Path(folder)) for python in arguments.pythons]
            said = visit_each(sides, much, arguments.rounds, visited)
    except BenchError as error:
        print(error, file=sys.stderr)
        return 2
    progress("")
    first, *others = sides
    code = 0
    for other in others:
        pairs = [(one[first.name], one[other.name]) for one in said]
        both = f"{first.name} (there), {other.name} (here)"
        loads = f"{load:.1f} before, {os.getloadavg()[0]:.1f} after"
        known = {**facts(), "python": both, "rounds": arguments.rounds, "margin": arguments.margin, "load": loads}
        code = max(code, beside.conclude(pairs, arguments.margin, known, None))
        print()
    return code


def side(python: str, folder: Path) -> beside.Side:
    """This tree on a Python, in an environment of its own. Raises BenchError."""
    name = "Python " + beside.run(python, "-c", "import platform; print(platform.python_version())")
    place = folder / name.replace(" ", "-")
    progress(f"an environment for {name}")
    versions = folder / "versions.txt"
    beside.freeze(versions)
    beside.run(python, "-m", "venv", str(place))
    beside.install(str(place / "bin/python"), beside.ROOT, versions)
    return beside.Side(name, beside.ROOT, str(place / "bin/python"))


def visit_each(
    sides: Sequence[beside.Side],
    much: visit.Amounts,
    rounds: int,
    visited: Callable[[beside.Side, visit.Amounts], beside.Said],
) -> Rounds:
    """Visit every side in each round, in the order ABC, BCA, CAB, and so on; returns what they told."""
    said: Rounds = []
    for turn in range(rounds):
        found = {}
        first = turn % len(sides)
        for one in (*sides[first:], *sides[:first]):
            progress(f"round {turn + 1} of {rounds}: {one.name}")
            found[one.name] = visited(one, beside.share(much, rounds, turn))
        said.append(found)
    return said


def visited(one: beside.Side, much: visit.Amounts) -> beside.Said:
    """A visit, and the imports."""
    found = beside.visited(one, much)
    if found:
        found["values"][MEASURE] = ([imported_ms(one.python) for _ in range(IMPORTS)], "ms")
    return found


def imported_ms(python: str) -> float:
    """From the start of an interpreter to its end, which does nothing but import failstop."""
    start_ns = time.monotonic_ns()
    subprocess.run([python, "-I", "-c", IMPORT], env=beside.environment(), check=True)
    return (time.monotonic_ns() - start_ns) / 1e6


if __name__ == "__main__":
    sys.exit(main())

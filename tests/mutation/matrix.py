"""Which test notices which mutant: a sample of a room's mutants, each tried by all of the tests that call it.

matrix.py --at DIRECTORY [--sample N] [--seed N]

DIRECTORY is one in which run.py has judged the room (--at). A room's run ends at the first test that fails, so it shows
that a mutant is noticed, but not by how many tests. This tries each mutant of the sample with every test that calls the
changed function. It prints for each test, with all its parameters, how many of these mutants it noticed, how many of
them no other test noticed, and, if it noticed none alone, the test that noticed the most of the same ones. Which
tests noticed which mutant stays in DIRECTORY/matrix.json, so a run that was ended goes on, and so does a larger sample.

A test that noticed nothing alone may say what another one says, so read both. It may also look at what no mutant
changes, for example at a number of the kernel's, so drop no test for this list alone.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

if __package__ is None:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.mutation.alone import alone, possible

NOTICED = 1
"""mutmut's code for a mutant that a test has noticed, which is pytest's exit code when a test has failed."""
ENDED = (0, NOTICED)
"""Exit codes of a pytest that has come to its end."""
TEST_S, LONGEST_S = 20.0, 200.0
"""How long a test may take, and all tests of one mutant. A mutant may never let a test come to its end."""

Matrix = Mapping[str, set[str]]
"""For each mutant the tests that noticed it."""


class Row(NamedTuple):
    """One test: how many mutants it alone noticed, how many it noticed, how many called functions it was tried with.

    `like`: the test that noticed the most of the same mutants, and how many; "" where it noticed one alone, or none."""

    alone: int
    noticed: int
    tried: int
    test: str
    like: str
    shared: int


def noticed(where: Path) -> list[str]:
    """The mutants that a test has noticed in the run in this directory, by name."""
    found = (json.loads(meta.read_text())["exit_code_by_key"] for meta in (where / "mutants").rglob("*.py.meta"))
    return sorted(name for codes in found for name, code in codes.items() if code == NOTICED)


def callers(where: Path) -> dict[str, list[str]]:
    """The tests that call each function, by the name with which its mutants begin."""
    stats = json.loads((where / "mutants" / "mutmut-stats.json").read_text())
    tests: dict[str, list[str]] = stats["tests_by_mangled_function_name"]
    return tests


def function(mutant: str) -> str:
    """The function that this mutant changes, as callers() names it."""
    return mutant.rpartition("__mutmut_")[0]


def failed(report: str, tests: list[str]) -> set[str]:
    """Those of these tests that pytest's summary names as failed. A test's name may have any character in it."""
    lines = [line.partition(" ")[2] for line in report.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    named = (max((it for it in tests if f"{line} - ".startswith(f"{it} - ")), key=len, default="") for line in lines)
    return set(named) - {""}


def tried(work: tuple[Path, str, list[str], bool]) -> tuple[str, set[str] | None]:
    """The mutant, and which of its tests fail with it switched on; None when pytest did not come to its end.

    `work`: the directory, the mutant, its tests, and whether a PID namespace is possible."""
    where, mutant, tests, separate = work
    copy = where / "mutants"
    words = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rfE", "-p", "no:cacheprovider", "-p", "no:xdist"]
    words += ["-p", "tests.mutation.loaded", "--timeout", str(TEST_S), "--rootdir", str(copy), *sorted(tests)]
    path = os.pathsep.join(map(str, (copy, copy / "lab")))
    environment = {**os.environ, "PYTHONPATH": path, "MUTANT_UNDER_TEST": mutant}
    with tempfile.TemporaryFile("w+", errors="replace") as report:

        def ended() -> int:
            done = subprocess.run(words, cwd=copy, env=environment, stdout=report, stderr=report, timeout=LONGEST_S)
            return done.returncode

        code = alone(ended, separate=separate)
        report.seek(0)
        return mutant, failed(report.read(), tests) if code in ENDED else None


def whole(tests: Iterable[str]) -> set[str]:
    """The tests, each with all its parameters as one."""
    return {test.partition("[")[0] for test in tests}


def rows(matrix: Matrix, tests: Mapping[str, Iterable[str]]) -> list[Row]:
    """A row for each test that was tried, those that noticed nothing alone first. `tests`: which were tried with each
    mutant."""
    calls = Counter(test for mutant in matrix for test in tests[mutant])
    found = {test: {mutant for mutant, by in matrix.items() if test in by} for test in calls}
    made = []
    for test, its in found.items():
        single = sum(matrix[mutant] == {test} for mutant in its)
        shared = Counter(other for mutant in its for other in matrix[mutant] if other != test)
        like = max(shared, key=lambda other: (shared[other], other)) if shared and not single else ""
        made.append(Row(single, len(its), calls[test], test, like, shared[like]))
    return sorted(made)


def main() -> int:
    """Try the sample, and print the tests."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at", type=Path, metavar="DIRECTORY", required=True)
    parser.add_argument("--sample", type=int, default=100, metavar="N", help="how many mutants (default: 100)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="which ones (default: 1)")
    args = parser.parse_args()
    where = args.at.resolve()
    try:
        every, by_function = noticed(where), callers(where)
    except FileNotFoundError:
        parser.error(f"{where} has no finished run: run.py --at {where} ROOM comes first")
    separate = possible()
    sample = random.Random(args.seed).sample(every, min(args.sample, len(every)))
    tests = {mutant: by_function[function(mutant)] for mutant in sample}
    kept = where / "matrix.json"
    known: dict[str, list[str] | None] = json.loads(kept.read_text()) if kept.exists() else {}
    work = [(where, mutant, tests[mutant], separate) for mutant in sample if mutant not in known]
    # A process each, because one that has begun a PID namespace can't begin another.
    with multiprocessing.get_context("fork").Pool(maxtasksperchild=1) as pool:
        for number, (mutant, by) in enumerate(pool.imap(tried, work, chunksize=1), 1):
            known[mutant] = None if by is None else sorted(by)
            kept.write_text(json.dumps(known))
            told = "pytest did not end" if by is None else f"{len(by)} of {len(tests[mutant])} tests"
            print(f"{number} of {len(work)}: {mutant}: {told}", file=sys.stderr, flush=True)
    matrix = {mutant: whole(names) for mutant in sample if (names := known[mutant]) is not None}
    lost = [mutant for mutant, by in matrix.items() if not by]
    print(f"{len(matrix)} of {len(every)} mutants tried, {len(sample) - len(matrix)} more ended the tests themselves")
    if lost:
        print(f"no test noticed {', '.join(lost)} this time")
    print("alone  noticed  tried  test")
    for row in rows(matrix, {mutant: whole(tests[mutant]) for mutant in matrix}):
        like = f"; {row.shared} of these by {row.like}" if row.like else ""
        print(f"{row.alone:5}  {row.noticed:7}  {row.tried:5}  {row.test}{like}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`python -m bench --beside REF`: this tree beside another commit, on one machine in one run.

The other commit gets a git worktree and an environment of its own. The two are visited in turn, in the order ABBA, so
that what slows the machine for a while slows both: each visit is a process of that commit with a service of its own,
which measures a little of everything (bench/visit.py). The interval of a ratio says what is known (bench/ratio.py).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench import BenchError, ratio, visit
from bench.report import progress
from failstop.doctor.machine import facts

ROOT = Path(__file__).parents[1]
INSTRUMENT = (
    *(f"bench/{name}" for name in ("carriers.py", "cost.py", "floor.c", "floor.py", "hangs.py", "kills.py")),
    *(
        "bench/latency.py",
        "bench/stats.py",
        "lab/failstop_lab/sim",
        "lab/failstop_lab/faults/crowd.py",
        "lab/failstop_lab/trial.py",
    ),
)
"""Files that measure, of each commit its own: where they differ, so may the numbers."""
ONCE = (50,)
OFTEN = (50, 99)
"""The percentiles of what a visit measures once, and of what it samples."""
FAILED = "visits that failed"
OURS = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
"""Variables of this process that a side does not get."""
Said = dict[str, Any] | None
"""Values and counts that a visit told; None when it failed."""


@dataclasses.dataclass(frozen=True)
class Side:
    """One of the two: what it is called, where it is, its interpreter."""

    name: str
    tree: Path
    python: str


@dataclasses.dataclass(frozen=True)
class Compared:
    """One measure: its percentiles, the other commit's beside this one's."""

    measure: str
    unit: str
    ratios: dict[int, ratio.Ratio]
    rounds: list[ratio.Round]

    @property
    def verdict(self) -> str:
        """The verdict on the whole row: the worst of its percentiles'."""
        return ratio.worst([one.verdict for one in self.ratios.values()])

    def lines(self) -> Iterator[str]:
        """Its verdict on each percentile."""
        samples = min(sum(len(one[side]) for one in self.rounds) for side in (0, 1))
        for percentile, one in self.ratios.items():
            found = f"{samples} samples in {len(self.rounds)} rounds: too few"
            if one.interval is not None:
                low, high = one.interval
                found = f"{low:.2f} to {high:.2f}, {one.verdict}"
            numbers = f"p{percentile} there {one.there:.2f}, here {one.here:.2f} {self.unit}"
            yield f"{numbers}: {one.value:.2f} x ({found})"


@dataclasses.dataclass(frozen=True)
class Counted:
    """Counts of things that should not happen: (found, of), the other commit's and this one's."""

    measure: str
    there: tuple[int, int]
    here: tuple[int, int]

    @property
    def verdict(self) -> str:
        """A stop that does not come is the slowest."""
        (was, of_there), (now, of_here) = self.there, self.here
        return ratio.SLOWER if now * of_there > was * of_here else ratio.NO_SLOWER

    def lines(self) -> Iterator[str]:
        """The counts."""
        yield "there {} of {}, here {} of {}".format(*self.there, *self.here)


def main(ref: str, much: visit.Amounts, rounds: int, margin: float, out: str | None) -> int:
    """Compare, print, write; exit code 1 when a row is slower, 2 when nothing could be compared."""
    try:
        commit = _git("rev-parse", "--verify", "--quiet", f"{ref}^{{commit}}", what=f"no such commit: {ref}")
        with _checked_out(commit) as there:
            said = visit_both(there, Side("this tree", ROOT, sys.executable), much, rounds, visited)
    except BenchError as error:
        progress("")
        print(error, file=sys.stderr)
        return 2
    progress("")
    known = {
        **facts(),
        "there": _git("log", "-1", "--format=%h %s", commit),
        "here": _git("log", "-1", "--format=%h %s") + (", with changes" if _git("status", "--porcelain") else ""),
        "rounds": rounds,
        "margin": margin,
        "instrument differs": _git("diff", "--name-only", commit, "--", *INSTRUMENT).split(),
    }
    return conclude(said, margin, known, out)


def conclude(said: list[tuple[Said, Said]], margin: float, known: dict[str, Any], out: str | None) -> int:
    """Compare the rounds, print, write; the exit code. `known`: facts to be told with it."""
    rows, counts = compared(said, margin)
    every: list[Compared | Counted] = [*rows, *counts]
    _print(known, every)
    if out:
        os.makedirs(os.path.dirname(out) or ".", exist_ok=True)
        with open(out, "w", encoding="utf-8") as file:
            json.dump({"machine": known, "rows": [_plain(row) for row in every]}, file, indent=2)
    if not rows:
        print("nothing was measured on both sides", file=sys.stderr)
        return 2
    return 1 if any(row.verdict == ratio.SLOWER for row in every) else 0


def share(much: visit.Amounts, rounds: int, turn: int) -> visit.Amounts:
    """The rows of one round; the moments are each round's own, and the same on both sides."""

    def part(whole: int) -> int:
        return whole * (turn + 1) // rounds - whole * turn // rounds

    return visit.Amounts(
        kills=part(much.kills),
        hangs=part(much.hangs),
        samples=part(much.samples),
        seconds=much.seconds / rounds,
        seed=much.seed + turn,
    )


def compared(said: list[tuple[Said, Said]], margin: float) -> tuple[list[Compared], list[Counted]]:
    """The rows of all rounds, each (there, here). A round that failed on one side counts on neither."""
    whole = [(there, here) for there, here in said if there and here]
    values = [(there["values"], here["values"]) for there, here in whole]
    counts = [(there["counts"], here["counts"]) for there, here in whole]
    rows = []
    for measure in _on_both(values):
        rounds = [(there[measure][0], here[measure][0]) for there, here in values]
        if not any(there or here for there, here in rounds):
            continue  # no trial of it was asked for
        unit = values[0][1][measure][1]
        percentiles = OFTEN if unit == "ms" else ONCE
        ratios = {percentile: ratio.compare(rounds, percentile, margin) for percentile in percentiles}
        rows.append(Compared(measure, unit, ratios, rounds))
    counted = [
        Counted(measure, *(_added([one[side][measure] for one in counts]) for side in (0, 1)))
        for measure in _on_both(counts)
    ]
    there, here = (sum(one[side] is None for one in said) for side in (0, 1))
    return rows, [*counted, Counted(FAILED, (there, len(said)), (here, len(said)))]


def _on_both(rounds: list[tuple[dict[str, Any], dict[str, Any]]]) -> list[str]:
    """The measures that every visit has, in this commit's order."""
    if not rounds:
        return []
    everywhere = set.intersection(*(set(one) for sides in rounds for one in sides))
    return [measure for measure in rounds[0][1] if measure in everywhere]


def _added(pairs: list[tuple[int, int]]) -> tuple[int, int]:
    return sum(found for found, _ in pairs), sum(of for _, of in pairs)


def visit_both(
    there: Side, here: Side, much: visit.Amounts, rounds: int, visited: Callable[[Side, visit.Amounts], Said]
) -> list[tuple[Said, Said]]:
    """Visit both sides in each round, in the order ABBA; returns what they told, (there, here)."""
    said = []
    for turn in range(rounds):
        found = {}
        for side in (there, here) if turn % 2 == 0 else (here, there):
            progress(f"round {turn + 1} of {rounds}: {side.name}")
            found[side.name] = visited(side, share(much, rounds, turn))
        said.append((found[there.name], found[here.name]))
    return said


def visited(side: Side, much: visit.Amounts) -> Said:
    """Visit one side; None when that fails, which is printed."""
    command = [side.python, "-m", "bench.visit", json.dumps(dataclasses.asdict(much))]
    process = subprocess.Popen(command, cwd=side.tree, env=environment(), stdout=subprocess.PIPE, text=True)
    try:
        said, _ = process.communicate()
    finally:
        process.terminate()  # unless it has ended; it ends its service first
        process.wait()
    if process.returncode:
        print(f"a visit to {side.name} failed", file=sys.stderr)
        return None
    found: dict[str, Any] = json.loads(said)
    return found


def environment() -> dict[str, str]:
    """That of a side: it finds the modules of its own tree, and compiles each once, as on a robot."""
    return {name: value for name, value in os.environ.items() if name not in OURS}


@contextlib.contextmanager
def _checked_out(commit: str) -> Iterator[Side]:
    """Another commit in a worktree and an environment of its own, with the versions of this one's packages."""
    with tempfile.TemporaryDirectory(prefix="failstop-beside-", dir="/var/tmp") as directory:
        tree = Path(directory, "tree")
        _git("worktree", "add", "--quiet", "--detach", str(tree), commit)
        try:
            progress(f"an environment for {commit[:9]}")
            python = str(tree / ".venv/bin/python")
            versions = Path(directory, "versions.txt")
            freeze(versions)
            run(sys.executable, "-m", "venv", str(tree / ".venv"))
            install(python, tree, versions)
            if not (tree / "bench/visit.py").exists():
                shutil.copy(visit.__file__, tree / "bench/visit.py")
            yield Side(commit[:9], tree, python)
        finally:
            _git("worktree", "remove", "--force", str(tree))


def freeze(versions: Path) -> None:
    """Write the versions of this environment's packages, as constraints for pip. Raises BenchError."""
    versions.write_text(run(sys.executable, "-m", "pip", "freeze", "--exclude-editable") + "\n", "utf-8")


def install(python: str, tree: Path, versions: Path) -> None:
    """Install the failstop of a tree into the environment of `python`, with these versions of what it needs. Raises
    BenchError."""
    pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    parts = [part for part in (tree, tree / "lab") if (part / "pyproject.toml").exists()]
    editable = ("--config-settings", "editable_mode=compat", *(f"--editable={part}" for part in parts))
    run(*pip, "--constraint", str(versions), *editable)


def _git(*words: str, what: str = "") -> str:
    return run("git", "-C", str(ROOT), *words, what=what)


def run(*command: str, what: str = "") -> str:
    """The output of a command. Raises BenchError with what it complained of, or with `what`."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except FileNotFoundError as error:
        raise BenchError(f"{command[0]} is not installed") from error
    except subprocess.CalledProcessError as error:
        raise BenchError(what or f"{' '.join(command)}: {error.stderr.strip()}") from error
    return done.stdout.strip()


def _print(known: dict[str, Any], rows: list[Compared | Counted]) -> None:
    for key, value in known.items():
        print(f"{key}: {', '.join(value) if isinstance(value, list) else value}")
    for row in rows:
        print(f"\n{row.measure}: {row.verdict}")
        for line in row.lines():
            print(f"    {line}")
    print()
    for verdict in (ratio.SLOWER, ratio.NOT_KNOWN):
        print(f"{verdict}: {'; '.join(row.measure for row in rows if row.verdict == verdict) or 'none'}")


def _plain(row: Compared | Counted) -> dict[str, Any]:
    return {**dataclasses.asdict(row), "verdict": row.verdict}

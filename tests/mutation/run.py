"""Mutation testing in a copy of the tree: which small changes of the code does neither a test nor mypy notice.

run.py [ROOM...]    rooms of rooms.py, without any: all. Exit code 1 when a survivor is unexplained, or when more than
                    3 % of the mutants survive that are not the same program.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

if __package__ is None:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.mutation.rooms import ROOMS
from tests.mutation.survivors import Outcome, report

LINKED = ("board", "procs", "ros2", "shm", "supervisor", "systemd")
SETTINGS = """
[tool.mutmut]
source_paths = ["failstop"]
only_mutate = {files}
also_copy = {copied}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:xdist"]
pytest_add_cli_args_test_selection = {tests}
# Every mutant of a method declares its attributes once more, which is no fault of the mutant.
type_check_command = [
    {python}, "-m", "mypy", "--output", "json", "--no-warn-unused-ignores", "--disable-error-code", "no-redef"
]
use_git_change_detection = false
process_isolation = "forkserver"
"""
# Run in the copy. Texts are left as they are: tests/docs holds what is said, and "XX..." is no decision.
# What the tests start finds the copy first.
MUTMUT = """
import os
os.environ["PYTHONPATH"] = os.path.abspath("mutants")
from mutmut.mutation import file_mutation, mutators
kept = [it for it in mutators.mutation_operators if it[1] is not mutators.operator_string]
file_mutation.mutation_operators = kept
from mutmut.__main__ import cli
cli()
"""


def copy(to: Path) -> None:
    """Every file that git knows; the rooms are real folders of the package here, as their modules are named."""
    root = Path(__file__).resolve().parents[2]
    names = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, check=True).stdout.split(b"\0")
    for name in (os.fsdecode(name) for name in names if name):
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        if (root / name).exists():
            shutil.copy2(root / name, to / name, follow_symlinks=False)
    for room in LINKED:
        (to / "failstop" / room).unlink()
        (to / room).rename(to / "failstop" / room)
        (to / room).symlink_to(f"failstop/{room}")


def settle(where: Path, rooms: list[str]) -> None:
    """mutmut's settings for these rooms."""
    chosen = [ROOMS[name] for name in rooms]
    tests = [str(found.relative_to(where)) for room in chosen for glob in room.tests for found in where.glob(glob)]
    wanted = {
        "files": json.dumps([f"failstop/{glob}" for room in chosen for glob in room.files]),
        "tests": json.dumps(sorted(set(tests))),
        "copied": json.dumps(sorted(path.name for path in where.iterdir() if path.name not in ("failstop", "tests"))),
        "python": json.dumps(sys.executable),
    }
    with (where / "pyproject.toml").open("a") as file:
        file.write(SETTINGS.format(**wanted))


def outcomes(where: Path) -> list[Outcome]:
    """What became of each mutant, from mutmut's own records."""
    found = []
    for meta in sorted((where / "mutants").rglob("*.py.meta")):
        for name, code in json.loads(meta.read_text())["exit_code_by_key"].items():
            path = str(meta.relative_to(where / "mutants").with_suffix("")).removeprefix("failstop/")
            changed = ""
            if code in (0, 33):
                shown = subprocess.run(
                    [sys.executable, "-c", MUTMUT, "show", name], cwd=where, capture_output=True, text=True, check=True
                ).stdout
                changed = "\n".join(
                    line for line in shown.splitlines() if line[:1] in ("+", "-") and line[:3] not in ("+++", "---")
                )
            found.append(Outcome(path, name, code, changed))
    return found


def main(*rooms: str) -> int:
    """Copy, mutate, judge."""
    if unknown := set(rooms) - set(ROOMS):
        print(f"no room {', '.join(sorted(unknown))}: there are {', '.join(ROOMS)}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        where = Path(name)
        copy(where)
        settle(where, list(rooms) or list(ROOMS))
        subprocess.run([sys.executable, "-c", MUTMUT, "run"], cwd=where, check=True)
        return report(outcomes(where))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

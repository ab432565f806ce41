"""Mutation testing in a copy of the tree: which small changes of the code does neither a test nor mypy notice.

run.py [--at DIRECTORY] [ROOM[/FILE]...]

Rooms of rooms.py, or single files of them (shm/cell); without any: all. Exit code 1 when a survivor is unexplained, or
when more than 3 % of the mutants survive that are not the same program. With a directory the copy stays there, and
a run that was ended goes on: what was killed stays so, what survived without a row is tried again, by the tests of now.
"""

from __future__ import annotations

import argparse
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
from tests.mutation.survivors import NOT_CALLED, NOT_TRIED, SURVIVED, Outcome, reason, report

ROOT = Path(__file__).resolve().parents[2]
MUTMUT = (sys.executable, "tests/mutation/mutate.py")
SETTINGS = """
[tool.mutmut]
source_paths = ["failstop"]
only_mutate = {files}
also_copy = {copied}
pytest_add_cli_args = ["-p", "no:cacheprovider", "-p", "no:xdist", "-p", "tests.mutation.loaded"]
pytest_add_cli_args_test_selection = {tests}
# Every mutant of a method declares its attributes once more, which is no fault of the mutant.
type_check_command = [
    {python}, "-m", "mypy", "--output", "json", "--no-warn-unused-ignores", "--disable-error-code", "no-redef"
]
use_git_change_detection = false
process_isolation = "forkserver"
# Seconds: five times what its tests take, and 15.
timeout_constant = 3.0
timeout_multiplier = 5.0
"""


def copy(to: Path) -> None:
    """Every file that git knows; the linked rooms are real folders of the package here, as their modules are named."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.split(b"\0")
    for old in to.iterdir():
        if old.name != "mutants":
            shutil.rmtree(old) if old.is_dir() and not old.is_symlink() else old.unlink()
    for name in (os.fsdecode(name) for name in names if name):
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, to / name, follow_symlinks=False)
    for link in [path for path in (to / "failstop").iterdir() if path.is_symlink()]:
        link.unlink()
        (to / link.name).rename(link)
        (to / link.name).symlink_to(f"failstop/{link.name}")


def chosen(where: Path, rooms: list[str]) -> tuple[list[str], list[str]]:
    """The files and the tests of these rooms; of a room's single file, all the room's tests."""
    files: set[str] = set()
    tests: set[str] = set()
    for room, _, name in (room.partition("/") for room in rooms):
        found = [path for path in matches(where, ROOMS[room].files) if name in ("", path.stem)]
        if not found:
            raise KeyError(name)
        files |= {f"failstop/{str(path.relative_to(where)).removeprefix('failstop/')}" for path in found}
        tests |= {str(path.relative_to(where)) for path in matches(where, ROOMS[room].tests)}
    return sorted(files), sorted(tests)


def matches(where: Path, patterns: tuple[str, ...]) -> list[Path]:
    """Files that these patterns match; LookupError for one that matches nothing: its file has another name now."""
    found = {pattern: list(where.glob(pattern)) for pattern in patterns}
    if lost := [pattern for pattern, paths in found.items() if not paths]:
        raise LookupError(f"nothing matches {', '.join(lost)}: mend tests/mutation/rooms.py")
    return [path for paths in found.values() for path in paths]


def settle(where: Path, rooms: list[str]) -> None:
    """mutmut's settings for these rooms."""
    files, tests = chosen(where, rooms)
    wanted = {
        "files": json.dumps(files),
        "tests": json.dumps(tests),
        "copied": json.dumps(
            sorted(path.name for path in where.iterdir() if path.name not in ("failstop", "tests", "mutants"))
        ),
        "python": json.dumps(sys.executable),
    }
    with (where / "pyproject.toml").open("a") as file:
        file.write(SETTINGS.format(**wanted))


def outcomes(where: Path) -> list[Outcome]:
    """The outcome of each mutant, from mutmut's own records."""
    codes = {
        (str(meta.relative_to(where / "mutants").with_suffix("")).removeprefix("failstop/"), name): code
        for meta in sorted((where / "mutants").rglob("*.py.meta"))
        for name, code in json.loads(meta.read_text())["exit_code_by_key"].items()
    }
    survivors = json.dumps([name for (_, name), code in codes.items() if code == SURVIVED])
    told = subprocess.run([*MUTMUT, "changes"], cwd=where, input=survivors, capture_output=True, text=True, check=True)
    diffs = json.loads(told.stdout)
    return [Outcome(path, name, code, _changed(diffs.get(name, ""))) for (path, name), code in codes.items()]


def _changed(diff: str) -> str:
    return "\n".join(line for line in diff.splitlines() if line[:1] in ("+", "-") and line[:3] not in ("+++", "---"))


def retry(where: Path) -> None:
    """Forget which mutants no row explains that survived an earlier run in this directory, and which were not tried."""
    again = {
        it.name
        for it in outcomes(where)
        if it.code in (NOT_CALLED, *NOT_TRIED) or (it.code == SURVIVED and not reason(it))
    }
    # Which test calls what is found out again: one that was changed keeps its name.
    (where / "mutants" / "mutmut-stats.json").unlink(missing_ok=True)
    for meta in (where / "mutants").rglob("*.py.meta"):
        data = json.loads(meta.read_text())
        codes = data["exit_code_by_key"]
        data["exit_code_by_key"] = {name: None if name in again else code for name, code in codes.items()}
        meta.write_text(json.dumps(data))


def mutate(where: Path, rooms: list[str]) -> int:
    """Copy, mutate, judge."""
    copy(where)
    settle(where, rooms)
    retry(where)
    subprocess.run([*MUTMUT, "run"], cwd=where, check=True)
    return report(outcomes(where))


def main() -> int:
    """In a directory that stays, or in a temporary one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at", type=Path, metavar="DIRECTORY")
    parser.add_argument("rooms", nargs="*", metavar="ROOM[/FILE]")
    args = parser.parse_args()
    rooms = args.rooms or list(ROOMS)
    if unknown := {room for room in rooms if room.partition("/")[0] not in ROOMS}:
        parser.error(f"no room {', '.join(sorted(unknown))}: there are {', '.join(ROOMS)}")
    if args.at:
        args.at.mkdir(parents=True, exist_ok=True)
        return mutate(args.at, rooms)
    with tempfile.TemporaryDirectory() as name:
        return mutate(Path(name), rooms)


if __name__ == "__main__":
    sys.exit(main())

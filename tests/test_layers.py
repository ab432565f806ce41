"""The rooms point one way: a reader of one needs no other but those below it. The core asks the machine by what
the simulated machine has too."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import HARMLESS, Loader
from failstop_lab.pages.rooms import EVERYBODYS, ROOMS, arrows
from tests.support import rooms
from tests.support.rooms import CORE, ROOT, imported, imports, modules, name_of, package

FEATURES = {"fleet", "guard", "web", "ros2", "setup", "lab"}
"""Rooms that a robot may do without, each with its commands."""
OF_A_TERMINAL = {
    "fleet": {"command", "metrics_command", "publisher", "report", "view"},
    "guard": {"command"},
    "ros2": {"command", "bridge"},
    "web": {"command"},
}
"""Modules of a feature that are its commands, with what these print."""
PROGRAM = "failstop.supervisor.bootstrap"
"""Run by its path, with a supervisor to start; imported for the name of a variable alone."""


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_its_row_names(room: str) -> None:
    assert modules(room)
    assert sorted(arrows(room)) == ROOMS[room].below.split()


def test_the_rooms_point_one_way() -> None:
    tuple(TopologicalSorter({room: row.below.split() for room, row in ROOMS.items()}).static_order())
    core = [(room, below) for room in CORE for below in ROOMS[room].below.split() if below not in CORE]
    assert not core


def test_every_folder_and_module_of_the_package_is_a_room() -> None:
    there = {path.stem for path in rooms.PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert there | {"lab"} == {*ROOMS, *EVERYBODYS}, "the laboratory is a package of its own"


def of_the_robot() -> list[Path]:
    return [path for path in package() if "lab" not in path.relative_to(ROOT).parts]


def outside_its_commands() -> list[Path]:
    """The modules of features that take from the API what they show."""
    return [path for room, commands in OF_A_TERMINAL.items() for path in modules(room) if path.stem not in commands]


@pytest.mark.parametrize(
    ("paths", "least", "not_for_them"),
    [(outside_its_commands, 10, {"cli"}), (of_the_robot, 100, {"lab"}), (lambda: modules("cli"), 10, FEATURES)],
    ids=[
        "features draw on no terminal",
        "a robot needs no laboratory",
        "the command line finds features by their names",
    ],
)
def test_a_room_is_not_for_everybody(paths: Callable[[], list[Path]], least: int, not_for_them: set[str]) -> None:
    found = paths()
    assert len(found) > least
    assert [
        (str(path.relative_to(ROOT)), name)
        for path in found
        for name in imported(path)
        if name.partition(".")[0] in not_for_them
    ] == []


def from_outside(path: Path) -> Iterator[str]:
    """The top names that a module imports beside failstop's, but for types."""
    for node in at_run_time(path):
        names = [name.name for name in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        yield from (name.partition(".")[0] for name in names if name)


def test_the_core_asks_the_system_by_modules_that_the_simulated_machine_has() -> None:
    known = HARMLESS | {name.partition(".")[0] for name in Loader(Machine()).system} | {"failstop"}
    below = {ROOT / "shm/futex.py", ROOT / "procs/rights.py", ROOT / "procs/starved.py"}
    paths = {path for room in CORE for path in modules(room)} - below
    wrong = [(str(path.relative_to(ROOT)), name) for path in paths for name in from_outside(path) if name not in known]
    assert not wrong


def test_the_core_needs_two_packages_of_others() -> None:
    """No stop depends on another, nor on one that the architecture does not name."""
    found = {name for room in CORE for path in modules(room) for name in from_outside(path)}
    others = sorted(found - sys.stdlib_module_names - {"failstop"})
    assert others == ["msgpack", "posix_ipc"]
    told = (ROOT / "docs/dev/architecture.md").read_text()
    assert all(f"`{name}`" in told for name in others)


def at_run_time(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Imports of a module, within functions too, but not for types alone."""
    return [node for node, types in imports(path) if not types]


def needed(module: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """The modules that it imports."""
    found = set()
    for node in at_run_time(path):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif node.module:
            found |= {name if (name := f"{node.module}.{each.name}") in modules else node.module for each in node.names}
    return found & modules.keys() - {module}


def test_no_module_imports_one_that_imports_it() -> None:
    found = {name_of(path): path for path in package()}
    assert len(found) > 250
    graph = {name: needed(name, path, found) for name, path in found.items()}
    del graph[PROGRAM]
    tuple(TopologicalSorter(graph).static_order())


def test_three_rooms_are_linked_into_the_package() -> None:
    """The rooms that the service runs as lie at the top; every other room is a folder of the package."""
    assert sorted(path.name for path in rooms.PACKAGE.iterdir() if path.is_symlink()) == list(rooms.LINKED)


BY_ITS_FOLDER = re.compile(rf"\b(from|import)\s+([\w.]+\s*,\s*)*({'|'.join(rooms.LINKED)})\b")
"""Found in the text of every file that imports a linked room so."""


def test_nobody_imports_a_linked_room_by_its_folder() -> None:
    """`import shm.cell` would be another module than `failstop.shm.cell`."""
    sources = [*package(), *(path for top in ("bench", "tests", "packaging") for path in (ROOT / top).rglob("*.py"))]
    suspects = [path for path in sources if BY_ITS_FOLDER.search(path.read_text())]
    assert len(sources) > 600
    assert Path(__file__) in suspects
    wrong = [
        (str(path.relative_to(ROOT)), name)
        for path in suspects
        for node, _ in imports(path)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names])
        if name.partition(".")[0] in rooms.LINKED and not (isinstance(node, ast.ImportFrom) and node.level)
    ]
    assert not wrong


def test_every_folder_at_the_top_says_what_it_is() -> None:
    """In a README of its own: a stranger opens one folder first."""
    made = re.compile(r"\.|__pycache__|build$|dist$|mutants$|site$|.*\.egg-info$")
    tops = {path.name for path in ROOT.iterdir() if path.is_dir() and not made.match(path.name)}
    assert {"failstop", "lab", "tests"} <= tops
    assert [top for top in sorted(tops) if not (ROOT / top / "README.md").exists()] == []

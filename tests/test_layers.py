"""The rooms point one way: whoever reads one of them needs no other but those below it. A process asks no machine but
its World. The face is no larger than it has to be."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BELOW = {
    "board": {"board"},
    "shm": {"shm"},
    "policy": {"policy", "board", "shm"},
    "procs": {"procs", "policy", "board", "shm"},
    "supervisor": {"supervisor", "procs", "policy", "board", "shm"},
}
"""What each room may import of failstop; the face (failstop, ros2) knows all of them."""
EVERYBODYS = {"version"}
FEATURES = {"fleet", "web", "ros2", "lab"}
"""What a robot may do without, each with its commands."""
MACHINE = {
    "time": {"monotonic", "monotonic_ns", "perf_counter", "sleep", "time", "time_ns"},
    "os": {"fork", "kill", "killpg", "pidfd_open", "posix_spawn", "posix_spawnp", "wait", "waitid", "waitpid"},
    "select": {"epoll", "poll", "select"},
    "port": {"unsent_bytes"},
}
"""What a World is asked for instead, by module."""
PROGRAM = "failstop.supervisor.child"
"""Run by its path, with a supervisor to start; imported for the name of a variable alone."""
WITHOUT_A_WORLD = {"procs/world.py", "supervisor/child.py", "supervisor/events.py", "supervisor/port.py"}
"""The world itself; what is said on stderr; the first burst of a run, before there is a process to hand one to."""


def modules(room: str) -> list[Path]:
    return sorted((ROOT / room).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """The names after `failstop.` of all that a module imports, for types too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if node.module != "failstop" else [f"failstop.{name.name}" for name in node.names]
        elif isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        else:
            continue
        yield from (name.removeprefix("failstop.") for name in names if name.startswith("failstop."))


MOST_OF_THE_FACE = 8500
"""Lines: what a robot carries beside the core stays smaller than that."""


def lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text().splitlines()) for path in paths)


def test_the_face_that_a_robot_carries_is_small() -> None:
    own = [path for path in (ROOT / "failstop").glob("*") if not path.is_symlink() and path.name != "lab"]
    face = [path for top in own for path in (top.rglob("*.py") if top.is_dir() else [top]) if path.suffix == ".py"]
    core = [path for room in BELOW for path in modules(room)]
    assert len(face) > 40
    assert lines(face) < min(MOST_OF_THE_FACE, lines(core))


@pytest.mark.parametrize("room", BELOW)
def test_a_room_imports_only_what_is_below_it(room: str) -> None:
    found = modules(room)
    assert found
    upward = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in found
        for name in imported(path)
        if name.partition(".")[0] not in BELOW[room] | EVERYBODYS
    ]
    assert not upward


def test_a_robot_needs_nothing_of_the_laboratory() -> None:
    """`demo`, `chaos`, `prove` and `sim` are found by their names, when they are asked for."""
    robots = [path for path in (ROOT / "failstop").rglob("*.py") if "lab" not in path.relative_to(ROOT).parts]
    robots += [path for room in (*BELOW, "ros2") for path in (ROOT / room).rglob("*.py")]
    assert len(robots) > 100
    wrong = [
        (str(path.relative_to(ROOT)), name) for path in robots for name in imported(path) if name.startswith("lab")
    ]
    assert not wrong


def test_the_command_line_knows_features_by_the_names_of_their_commands_alone() -> None:
    """A command lies in the room of what it is for; `cli/main.py` imports it when it is asked for."""
    wrong = [
        (str(path.relative_to(ROOT)), name)
        for path in modules("failstop/cli")
        for name in imported(path)
        if name.partition(".")[0] in FEATURES
    ]
    assert modules("failstop/cli")
    assert not wrong


def asked(path: Path) -> set[str]:
    """What a module asks the machine itself."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = node.module.rpartition(".")[2]
            found |= {f"{module}.{name.name}" for name in node.names if name.name in MACHINE.get(module, ())}
        elif isinstance(node, ast.Attribute) and node.attr in MACHINE.get(ast.unparse(node.value), ()):
            found.add(ast.unparse(node))
    return found


def test_a_process_asks_no_machine_but_its_world() -> None:
    named = {str(path.relative_to(ROOT)): asked(path) for room in ("procs", "supervisor") for path in modules(room)}
    assert {path: found for path, found in named.items() if found and path not in WITHOUT_A_WORLD} == {}
    assert all(named[path] for path in WITHOUT_A_WORLD)


def at_run_time(tree: ast.AST) -> Iterator[ast.AST]:
    """What is imported, within functions too, but not for types alone."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield node
            yield from at_run_time(node)


def needed(module: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """The modules that it imports."""
    found = set()
    for node in at_run_time(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {name if (name := f"{node.module}.{each.name}") in modules else node.module for each in node.names}
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found & modules.keys() - {module}


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "failstop" else ("failstop", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_no_module_imports_one_that_imports_it() -> None:
    paths = [path for path in (ROOT / "failstop").rglob("*.py") if not path.parent.is_symlink()]
    for room in (*BELOW, "ros2", "fleet", "web"):
        paths += (ROOT / room).rglob("*.py")
    found = {name_of(path): path for path in paths}
    assert len(found) > 250
    graph = {name: needed(name, path, found) for name, path in found.items()}
    del graph[PROGRAM]
    tuple(TopologicalSorter(graph).static_order())

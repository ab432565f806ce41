"""The rooms of the package: what each is, what it may import, and the picture of them in docs/dev/architecture.md."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "failstop"
LABORATORY = ROOT / "lab" / "failstop_lab"
LINKED = ("procs", "shm", "supervisor")
"""Rooms at the top, linked into the package: what the service runs as."""


class Room(NamedTuple):
    """A folder or a module of the package."""

    what: str
    below: str
    """Every room that it imports, for types too."""


ROOMS = {
    "lab": Room(
        "breaks it on purpose: simulated board, faults, stand test; makes the pages",
        "api board cli config doctor files fleet helpers instances messages policy procs ros2 setup shm stop_tool "
        "supervisor",
    ),
    "web": Room("the operator's page", "api cli config extras files helpers incidents messages policy shm"),
    "guard": Room("a port that plays the board for a driver", "api board cli config doctor files messages policy"),
    "fleet": Room("the robots of a broker, and metrics", "api cli config doctor extras files messages notify policy"),
    "setup": Room(
        "from a cable to a proved robot",
        "api board cli config doctor files helpers instances messages policy procs stop_tool supervisor",
    ),
    "ros2": Room("the bridge to ROS 2", "api cli doctor helpers messages policy shm"),
    "cli": Room(
        "the commands, and what they draw on a terminal",
        "api board config doctor files helpers incidents instances messages policy procs stop_tool supervisor",
    ),
    "doctor": Room(
        "what on this weakens the promises",
        "api board config files instances messages policy procs shm stop_tool supervisor",
    ),
    "incidents": Room("the black box: each stop as a file", "api board extras files helpers messages policy shm"),
    "api": Room("the robot from Python, and what is shown of it", "board files instances messages policy shm"),
    "config": Room("the settings file", "files policy"),
    "instances": Room("the services of this machine, by name", "files shm"),
    "stop_tool": Room("the stop without a service", "board"),
    "extras": Room("packages that a part may lack", ""),
    "supervisor": Room(
        "starts and watches the processes; the latch, the stops, the events",
        "board files messages notify policy procs shm",
    ),
    "procs": Room("the four other processes", "board files messages policy shm"),
    "policy": Room("settings, causes, the process table, kinematics: pure", "board messages"),
    "messages": Room("the records that processes exchange", "files shm"),
    "board": Room("the wire and the port", "files"),
    "shm": Room("shared memory, futexes and lifelines", "files"),
    "helpers": Room("the Python processes that a command starts", ""),
    "notify": Room("datagrams for the service manager", ""),
    "files": Room("files and folders that nobody can plant", ""),
}
"""The most important first: the picture's order within a level."""
EVERYBODYS = ("__init__", "__main__", "data", "version")
"""Modules beside the rooms: what a program imports first, and what everybody may import."""


def folder(room: str) -> Path:
    """The folder of a room of the package, or the module of that name."""
    first, _, rest = room.partition("/")
    if first == "lab":
        return LABORATORY / rest
    path = ROOT / room if first in LINKED else PACKAGE / room
    return path if path.exists() else path.with_suffix(".py")


def modules(room: str) -> list[Path]:
    """The files of a room, in order."""
    place = folder(room)
    return sorted(place.rglob("*.py")) if place.is_dir() else [place]


class Import(NamedTuple):
    """An import statement of a module."""

    node: ast.Import | ast.ImportFrom
    types: bool
    """Whether it is for types alone: in `if TYPE_CHECKING`."""


@cache
def imports(path: Path) -> tuple[Import, ...]:
    """Every import of a module, within functions too."""
    return tuple(_imports(ast.parse(path.read_text()), types=False))


def _imports(node: ast.AST, *, types: bool) -> Iterator[Import]:
    """The imports in the statements of this node. Expressions are not searched, because none can hold an import."""
    types = types or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    for block in ("body", "orelse", "finalbody", "handlers", "cases"):
        for each in getattr(node, block, ()):
            if isinstance(each, ast.Import | ast.ImportFrom):
                yield Import(each, types)
            else:
                yield from _imports(each, types=types)


def imported(path: Path) -> Iterator[str]:
    """The names after `failstop.` of all that a module imports, for types too; the laboratory's begin with `lab.`."""
    for node, _ in imports(path):
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif node.module:
            names = [node.module]
            if node.module in ("failstop", "failstop_lab"):
                names = [f"{node.module}.{name.name}" for name in node.names]
        else:
            continue
        names = [name.replace("failstop_lab", "failstop.lab", 1) for name in names]
        yield from (name.removeprefix("failstop.") for name in names if name.startswith("failstop."))


@cache
def arrows(room: str) -> frozenset[str]:
    """The rooms that this one imports."""
    found = {name.partition(".")[0] for path in modules(room) for name in imported(path)}
    return frozenset(found - {room, *EVERYBODYS})


def _reached(room: str) -> set[str]:
    """Every room below this one."""
    return set(arrows(room)).union(*map(_reached, arrows(room)))


def _level(room: str) -> int:
    return 1 + max(map(_level, arrows(room)), default=0)


def picture() -> str:
    """A line for each room, above all that it imports: its place, its arrows but for those that others imply, and what
    it is."""
    rows = []
    for room in sorted(ROOMS, key=lambda room: (-_level(room), list(ROOMS).index(room))):
        implied = set[str]().union(*map(_reached, arrows(room)))
        nearest = " ".join(each for each in ROOMS if each in arrows(room) - implied)
        place = f"{folder(room).relative_to(ROOT)}{'/' * folder(room).is_dir()}"
        rows.append((place, f"-> {nearest}" if nearest else "", ROOMS[room].what))
    first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
    lines = [f" {place:<{first}}  {to:<{second}}  {what}" for place, to, what in rows]
    return "\n".join(["```text", *lines, "```"])

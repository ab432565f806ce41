"""One word, one thing: a name that a module defines for others is defined once in the core, and means one thing there
and in the lab."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.support.rooms import CORE, ROOT, modules

OTHER_BOARDS = {"arduino", "damiao", "feetech", "hoverboard", "ugv", "vesc"}
"""Folders of the board room that define what the room's own modules do, each for another board."""
EVERYWHERE = {
    "BATTERY": "the record and the cause: each has its own name in capitals, in records.py and in causes.py",
    "TYPE_CHECKING": "what type checkers take to be true, of a name that costs no import",
    "MS": "a unit",
    "TICK_NS": "of each process that has one, its own",
    "run": "the program of each process",
    "from_settings": "what a room makes of the settings, under the name of the module",
}
"""Names that several modules of the core define, and why they may."""
OF_THE_LAB = {
    "HELD": "bytes that an Arduino holds",
    "HELLO": "the first packet of usbredir",
    "Imu": "the simulated one",
    "Port": "the simulated one",
    "Process": "the simulated one",
    "RESET": "a packet of usbredir",
    "main": "a command",
}
"""Names of the core that the lab defines, too."""


def names(path: Path) -> Iterator[str]:
    """The public names that a module defines at its top."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            yield from (each.id for each in ast.walk(target) if isinstance(each, ast.Name))


def defined(paths: list[Path]) -> dict[str, list[str]]:
    """The modules that define each public name."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for path in paths:
        for name in sorted({name for name in names(path) if not name.startswith("_")}):
            found[name].append(str(path.relative_to(ROOT)))
    return found


@cache
def core() -> dict[str, list[str]]:
    paths = [path for room in CORE for path in modules(room)]
    return defined([path for path in paths if OTHER_BOARDS.isdisjoint(path.relative_to(ROOT).parts)])


def test_a_name_is_defined_once_in_the_core() -> None:
    twice = {name: places for name, places in core().items() if len(places) > 1}
    assert {name: places for name, places in twice.items() if name not in EVERYWHERE} == {}
    assert sorted(twice) == sorted(EVERYWHERE), "a name that is defined once by now needs no row"


def test_the_lab_uses_no_name_of_the_core_for_something_else() -> None:
    of_the_core, of_the_lab = core(), defined(modules("lab"))
    both = of_the_core.keys() & of_the_lab.keys() - EVERYWHERE.keys()
    assert len(of_the_core) > 800
    assert {name: of_the_lab[name] for name in both if name not in OF_THE_LAB} == {}
    assert both == OF_THE_LAB.keys(), "a name that the lab does not define by now needs no row"

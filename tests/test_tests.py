"""How the tests are made: few stages, few patches, few reaches into what is private, and names that fit on a line."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from tests.support import starting

TESTS = Path(__file__).parent
STAGES = ("Scene", "Stage", "World", "Harness")
"""A class whose name ends so builds a part of the service around what it tests."""
PATCHES = ("setattr", "setitem", "delattr")
NO_REACH = frozenset({"_exit", "_replace", "_fields", "_asdict", "_make"})
"""Of `os` and of named tuples: public, whatever their names say."""
LONGEST_NAME = 80
MAY_HAVE_ONE = re.compile(
    rf"class \w*({'|'.join(STAGES)})\b|\.({'|'.join(PATCHES)})\b|(?<!\bself)(?<!\bcls)\._[^_]"
    rf"|def test_\w{{{LONGEST_NAME - 4},}}"
)
"""Found in the text of every file with one of what is looked for, so that the others need no parsing."""


def is_stage(node: ast.AST) -> bool:
    return isinstance(node, ast.ClassDef) and node.name.endswith(STAGES)


def is_patch(node: ast.AST) -> bool:
    """A call such as monkeypatch.setattr(...): environment and chdir do not count."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    return node.func.attr in PATCHES and "patch" in ast.unparse(node.func.value)


def is_reach(node: ast.AST) -> bool:
    """x._name, where x is not the object itself."""
    if not isinstance(node, ast.Attribute) or not node.attr.startswith("_") or node.attr.startswith("__"):
        return False
    own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
    return not own and node.attr not in NO_REACH


def is_long(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and len(node.name) > LONGEST_NAME


def found(wanted: Callable[[ast.AST], bool], nodes: Iterable[ast.AST]) -> list[int]:
    """The lines of what is wanted."""
    return sorted(getattr(node, "lineno", 0) for node in nodes if wanted(node))


@functools.cache
def sources() -> dict[Path, list[ast.AST]]:
    """The nodes of each file that may have one of them; the stand-in of ROS has the names that ROS gives."""
    texts = {path: path.read_text("utf-8") for path in sorted(TESTS.rglob("*.py")) if "standin" not in path.parts}
    assert len(texts) > 300
    return {path: starting.nodes(ast.parse(text)) for path, text in texts.items() if MAY_HAVE_ONE.search(text)}


def everywhere(wanted: Callable[[ast.AST], bool]) -> Iterator[str]:
    """Each place of the tests where it is."""
    for path, nodes in sources().items():
        yield from (f"{path.relative_to(TESTS)}:{line}" for line in found(wanted, nodes))


@pytest.mark.parametrize(("wanted", "most"), [(is_stage, 6), (is_patch, 40), (is_reach, 50), (is_long, 0)])
def test_tests_have_no_more_of_it(wanted: Callable[[ast.AST], bool], most: int) -> None:
    places = list(everywhere(wanted))
    assert len(places) <= most, "\n".join(places)


@pytest.mark.parametrize(
    ("wanted", "source", "is_one"),
    [
        *((is_stage, "class PortScene: pass", True), (is_stage, "class Scenery: pass", False)),
        *((is_patch, call, True) for call in ("monkeypatch.setattr(os, 'kill', f)", "patch.setitem(d, 1, 2)")),
        *((is_patch, call, False) for call in ("monkeypatch.setenv('A', 'b')", "setattr(a, 'b', 1)")),
        *((is_reach, source, True) for source in ("a._b", "self.a._b()")),
        *((is_reach, source, False) for source in ("self._b", "os._exit(0)", "a.__b__")),
        *((is_long, f"def test_{length * 'x'}(): pass", length > 75) for length in (75, 76)),
        (is_long, f"def help_{76 * 'x'}(): pass", False),
    ],
)
def test_one_of_it_is_known(wanted: Callable[[ast.AST], bool], source: str, *, is_one: bool) -> None:
    assert bool(found(wanted, ast.walk(ast.parse(source)))) is is_one
    assert not is_one or MAY_HAVE_ONE.search(source)


SHARED = "support"


def wrong(path: Path, tests: Path = TESTS) -> list[str]:
    """Imports of a file that it should not make."""
    room = path.relative_to(tests).parts[0] if path.parent != tests else ""
    found = []
    for name in sorted(set().union(*starting.read(path).imports.values())):
        top, *parts = name.split(".")
        if top != "tests" or not parts:
            continue
        foreign = (tests / parts[0]).is_dir() and parts[0] not in (room, SHARED)
        if foreign or any(part.startswith("test_") for part in parts[:2]):
            found.append(".".join(parts))
    return found


def test_what_tests_share_is_in_support() -> None:
    files = [path for path in TESTS.rglob("*.py") if "standin" not in path.parts]
    assert len(files) > 200
    assert {str(path.relative_to(TESTS)): found for path in files if (found := wrong(path))} == {}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from tests.two.helper import it", ["two.helper", "two.helper.it"]),
        *((f"from {it} import it", ["one.test_it", "one.test_it.it"]) for it in ("tests.one.test_it", ".test_it")),
        ("from . import test_it", ["one.test_it"]),
        ("from ..two import helper", ["two", "two.helper"]),
        ("import tests.two.helper", ["two.helper"]),
        *((f"from {it} import it", []) for it in (".helper", "tests.one", "tests.support.pure", "failstop.lab.trial")),
    ],
)
def test_the_check_sees_it(source: str, found: list[str], tmp_path: Path) -> None:
    tests = tmp_path / "tests"
    for room in ("one", "two", "support"):
        (tests / room).mkdir(parents=True)
    path = tests / "one/test_other.py"
    path.write_text(source)
    assert wrong(path, tests) == found

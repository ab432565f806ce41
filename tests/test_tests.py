"""How the tests are made: few stages, few patches, few reaches into what is private, and names that fit on a line."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

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
    return {path: list(ast.walk(ast.parse(text))) for path, text in texts.items() if MAY_HAVE_ONE.search(text)}


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
        (is_stage, "class PortScene: pass", True),
        (is_stage, "class Scenery: pass", False),
        (is_patch, "monkeypatch.setattr(os, 'kill', f)", True),
        (is_patch, "patch.setitem(d, 1, 2)", True),
        (is_patch, "monkeypatch.setenv('A', 'b')", False),
        (is_patch, "setattr(a, 'b', 1)", False),
        (is_reach, "a._b", True),
        (is_reach, "self.a._b()", True),
        (is_reach, "self._b", False),
        (is_reach, "os._exit(0)", False),
        (is_reach, "a.__b__", False),
        (is_long, f"def test_{75 * 'x'}(): pass", False),
        (is_long, f"def test_{76 * 'x'}(): pass", True),
        (is_long, f"def help_{76 * 'x'}(): pass", False),
    ],
)
def test_one_of_it_is_known(wanted: Callable[[ast.AST], bool], source: str, *, is_one: bool) -> None:
    assert bool(found(wanted, ast.walk(ast.parse(source)))) is is_one
    assert not is_one or MAY_HAVE_ONE.search(source)

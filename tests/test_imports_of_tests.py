"""Tests share through tests/support: no test file imports another, and no room another's helpers."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SHARED = "support"


def imported(path: Path, tests: Path = TESTS) -> Iterator[str]:
    """The modules of the tests that a file imports, as names below tests."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            package = ("tests", *path.relative_to(tests).parts)[: -node.level] if node.level else ()
            module = ".".join((*package, *([node.module] if node.module else ())))
            names = [f"{module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from (name.removeprefix("tests.") for name in names if name.startswith("tests."))


def wrong(path: Path, tests: Path = TESTS) -> list[str]:
    """Imports of a file that it should not make."""
    room = path.relative_to(tests).parts[0] if path.parent != tests else ""
    found = []
    for name in imported(path, tests):
        parts = name.split(".")
        foreign = (tests / parts[0]).is_dir() and parts[0] not in (room, SHARED)
        if foreign or any(part.startswith("test_") for part in parts[:2]):
            found.append(name)
    return found


def test_what_tests_share_is_in_support() -> None:
    files = [path for path in TESTS.rglob("*.py") if "standin" not in path.parts]
    assert len(files) > 200
    assert {str(path.relative_to(TESTS)): found for path in files if (found := wrong(path))} == {}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from tests.two.helper import it", ["two.helper.it"]),
        ("from tests.one.test_it import it", ["one.test_it.it"]),
        ("from .test_it import it", ["one.test_it.it"]),
        ("from . import test_it", ["one.test_it"]),
        ("from ..two import helper", ["two.helper"]),
        ("import tests.two.helper", ["two.helper"]),
        ("from .helper import it", []),
        ("from tests.one import helper", []),
        ("from tests.support.pure import it", []),
        ("from failstop.lab.trial import Trial", []),
    ],
)
def test_the_check_sees_it(source: str, found: list[str], tmp_path: Path) -> None:
    for room in ("one", "two", "support"):
        (tmp_path / room).mkdir()
    path = tmp_path / "one/test_other.py"
    path.write_text(source)
    assert wrong(path, tmp_path) == found

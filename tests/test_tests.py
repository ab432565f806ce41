"""Tests share helpers through tests/support and their own room, and through nothing else."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

import pytest

from tests.support import starting

TESTS = Path(__file__).parent
SHARED = "support"


def wrong(path: Path, tests: Path = TESTS) -> list[str]:
    """Imports of a file that it should not make."""
    own = path.relative_to(tests).parts[:-1]
    found = []
    for name in sorted(set().union(*starting.read(path).imports.values())):
        top, *parts = name.split(".")
        if top != "tests" or not parts:
            continue
        folder = _folder(tests, parts)
        related = own and folder[: len(own)] == own[: len(folder)]
        foreign = folder and folder[0] != SHARED and not related
        if foreign or any(part.startswith("test_") for part in parts[: len(folder) + 1]):
            found.append(".".join(parts))
    return found


def _folder(tests: Path, parts: list[str]) -> tuple[str, ...]:
    """The folders among the parts of a module's name."""
    above = accumulate(parts, Path.joinpath, initial=tests)
    return tuple(part for part, path in zip(parts, list(above)[1:], strict=True) if path.is_dir())


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
        *((f"from {it} import it", []) for it in (".helper", "tests.one", "tests.support.pure", "failstop_lab.trial")),
    ],
)
def test_the_check_sees_it(source: str, found: list[str], tmp_path: Path) -> None:
    tests = tmp_path / "tests"
    for room in ("one", "two", "support"):
        (tests / room).mkdir(parents=True)
    path = tests / "one/test_other.py"
    path.write_text(source)
    assert wrong(path, tests) == found

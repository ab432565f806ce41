"""Sentences of the code can be read alone: none begins with a pronoun or a conjunction."""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.policy.settings import DECLARED

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("failstop", "procs", "shm", "supervisor", "bench", "packaging", "model", "integrations")
MADE = "build"
"""A folder of what is built."""
STANDIN = "standin"
"""A folder of what stands in for ROS, or for LeRobot: its modules say what theirs do."""
LEANS = re.compile(r"(who|whom|whose|whoever|what|whatever|which|whichever|the same|and|but|nor|or)\b", re.IGNORECASE)
MAY_LEAN = re.compile(rf"#[#: ]*{LEANS.pattern}", LEANS.flags)
MAY_LEAN_IN_QUOTES = re.compile(rf"(^\s*\w?|\"\")[\"']\s*{LEANS.pattern}", LEANS.flags | re.MULTILINE)
"""Found in every file with a docstring that may lean, so that the others need no parsing."""


def paths() -> Iterator[Path]:
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            if MADE not in path.relative_to(ROOT).parts:
                yield path


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Those of attributes too: every string that is a statement. Only of a file in which one may lean."""
    text = path.read_text()
    left: list[ast.AST] = [ast.parse(text)] if MAY_LEAN_IN_QUOTES.search(text) else []
    for node in left:
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):
            left += getattr(node, block, ())
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value.strip()


def comments(path: Path) -> Iterator[tuple[int, str]]:
    """The first line of each: a line that goes on with one is no begin. Only of a file in which one may lean."""
    if not MAY_LEAN.search(path.read_text()):
        return
    before = -1
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT:
                if token.start[0] != before + 1 or token.line[: token.start[1]].strip():
                    yield token.start[0], token.string.lstrip("#: ")
                before = token.start[0]


def leaning(paths: list[Path]) -> list[str]:
    found = [(path, line, text) for path in paths for of in (docstrings, comments) for line, text in of(path)]
    return [f"{path}:{line}: {text[:60]}" for path, line, text in found if LEANS.match(text)]


def test_no_docstring_or_comment_begins_with_a_word_that_leans_on_another_sentence() -> None:
    assert len(every := list(paths())) > 500
    assert leaning(every) == []


def test_no_docstring_of_the_tests_begins_so() -> None:
    left_out = {ROOT / "tests" / room / STANDIN for room in ("ros2", "kiwi")}
    every = [path for path in sorted((ROOT / "tests").rglob("*.py")) if not left_out & set(path.parents)]
    assert len(every) > 400
    found = [(path, line, text) for path in every for line, text in docstrings(path)]
    assert [f"{path}:{line}: {text[:60]}" for path, line, text in found if LEANS.match(text)] == []


@pytest.mark.parametrize(
    "source",
    [
        'def it():\n    """Who it is."""\n',
        "def it():\n    'and it is.'\n",
        'def it():\n    """\n    What it is.\n    """\n',
        'it = 1\nr"""Which."""\n',
        "it = 1  # the same\n",
        "if it:\n    #: but not so\n    pass\n",
    ],
)
def test_the_check_sees_it(source: str, tmp_path: Path) -> None:
    (tmp_path / "it.py").write_text(source)
    assert len(leaning([tmp_path / "it.py"])) == 1


def test_no_setting_s_text_begins_with_a_word_that_leans_on_another_sentence() -> None:
    texts = {setting.key: setting.doc for setting in DECLARED}
    assert len(texts) > 50
    assert {key: text for key, text in texts.items() if LEANS.match(text)} == {}

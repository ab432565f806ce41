"""Sentences of the code can be read alone: none begins with a pronoun or a conjunction."""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from failstop.policy.settings import DECLARED

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("failstop", "procs", "shm", "supervisor", "bench", "packaging", "model", "integrations")
MADE = "build"
"""A folder of what is built."""
STANDIN = "standin"
"""A folder of what stands in for ROS, or for LeRobot: its modules say what theirs do."""
LEANS = re.compile(r"(who|whom|whose|whoever|what|whatever|which|whichever|the same|and|but|nor|or)\b", re.IGNORECASE)
MAY_LEAN = re.compile(rf"#[#: ]*{LEANS.pattern}", LEANS.flags)


def paths() -> Iterator[Path]:
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            if MADE not in path.relative_to(ROOT).parts:
                yield path


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Those of attributes too: every string that is a statement."""
    left: list[ast.AST] = [ast.parse(path.read_text())]
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


def test_no_docstring_or_comment_begins_with_a_word_that_leans_on_another_sentence() -> None:
    found = [(path, line, text) for path in paths() for of in (docstrings, comments) for line, text in of(path)]
    assert len(found) > 3000
    assert [f"{path.relative_to(ROOT)}:{line}: {text[:60]}" for path, line, text in found if LEANS.match(text)] == []


def test_no_docstring_of_the_tests_begins_so() -> None:
    left_out = {ROOT / "tests" / room / STANDIN for room in ("ros2", "kiwi")}
    paths = [path for path in sorted((ROOT / "tests").rglob("*.py")) if not left_out & set(path.parents)]
    found = [(path, line, text) for path in paths for line, text in docstrings(path)]
    assert len(found) > 1000
    assert [f"{path.relative_to(ROOT)}:{line}: {text[:60]}" for path, line, text in found if LEANS.match(text)] == []


def test_no_setting_s_text_begins_with_a_word_that_leans_on_another_sentence() -> None:
    texts = {setting.key: setting.doc for setting in DECLARED}
    assert len(texts) > 50
    assert {key: text for key, text in texts.items() if LEANS.match(text)} == {}

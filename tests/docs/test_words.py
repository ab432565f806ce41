"""One word for one thing: what the glossary (docs/safety.md) has a word for has no other, on pages and on screens."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.pages import PAGES, ROOT
from tests.support.rooms import modules
from tests.support.starting import nodes

WENT = {
    r"e-stop": "stop; latched stop",
    r"estop": "stop; latched stop",
    r"dead ?man": "timeout",
    r"cmd timeout": "no command",
    r"for ever": "forever",
    r"anew": "again; restarted",
    r"told to stand": "stop",
}
"""Words that went, as regular expressions, and what is said instead."""
GONE = re.compile(rf"\b(?:{'|'.join(WENT)})\b", re.IGNORECASE)
ROOMS = (
    "api",
    "cli",
    "config",
    "doctor",
    "extras",
    "incidents",
    "instances",
    "stop_tool",
    "policy",
    "procs",
    "supervisor",
)
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
NAMES = re.compile(r"\bfailstop estop\b|\bestop\(\)|\bRobot\.estop\b|\bscan or estop\b|\bestop_\w+")
"""Words of the command, of the API and of topics."""


def sentences(path: Path) -> Iterator[str]:
    """The texts of a module that people may see: those with a space, but for its documentation."""
    found = nodes(ast.parse(path.read_text()))
    alone = {id(node.value) for node in found if isinstance(node, ast.Expr)}
    for node in found:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
            yield from (line for line in node.value.splitlines() if " " in line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_has_none_of_the_words_that_went(page: Path) -> None:
    text = page.read_text()
    assert GONE.findall(NAMES.sub("", CODE.sub("", text))) == []
    shown = "".join(CODE.findall(text)) if page.name not in ("ros2.md", "logs.md") else ""
    assert re.findall(r"\be-stop\b|told to stand", shown, re.IGNORECASE) == []


@pytest.mark.parametrize("room", ROOMS)
def test_a_screen_has_none_of_the_words_that_went(room: str) -> None:
    found = []
    for path in modules(room):
        found += [(str(path), text) for text in sentences(path) if GONE.search(NAMES.sub("", text))]
    assert found == []


def test_the_glossary_has_the_words_that_stay() -> None:
    glossary = (ROOT / "docs" / "safety.md").read_text().partition("## Words")[2].partition("\n## ")[0]
    for word in ("stop", "latched stop", "timeout", "blocked", "reset", "enable"):
        assert f"| {word} |" in glossary, word

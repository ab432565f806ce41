"""How to add: each recipe of docs/dev/architecture.md is three steps, and every file, name and target in it exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.pages import ROOT

PAGE = ROOT / "docs" / "dev" / "architecture.md"
WANTED = ("A cause", "A setting", "A board", "A command", "A page", "A fault", "A test")


def recipes(text: str) -> dict[str, list[str]]:
    """The steps of each recipe, by its title."""
    part = text.partition("\n## How to add\n")[2].partition("\n## ")[0]
    found = re.findall(r"^### (.*)\n((?:\d\. .*\n)+)", part, re.MULTILINE)
    return {title: re.findall(r"^\d\. (.*)$", steps, re.MULTILINE) for title, steps in found}


def lost(text: str, root: Path = ROOT) -> list[str]:
    """What a text names in backquotes and what is not there: files, folders, and names in capitals of its files."""
    words = re.findall(r"`([^`]+)`", text)
    files = [word for word in words if re.fullmatch(r"[\w./]+/|[\w./-]+/[\w.-]+\.\w+", word)]
    wrong = [word for word in files if not (root / word).exists()]
    sources = "".join((root / word).read_text() for word in files if word.endswith(".py") and (root / word).is_file())
    names = [word for word in words if re.fullmatch(r"[A-Z][A-Z_]+|every_board|Kind|Peer", word)]
    return wrong + [name for name in names if not re.search(rf"\b{name}\b", sources)]


def test_each_thing_that_people_add_has_three_steps() -> None:
    found = recipes(PAGE.read_text())
    assert tuple(found) == WANTED
    assert {title: len(steps) for title, steps in found.items()} == dict.fromkeys(WANTED, 3)


@pytest.mark.parametrize("title", WANTED)
def test_what_a_recipe_names_is_there(title: str) -> None:
    assert lost(" ".join(recipes(PAGE.read_text())[title])) == []


def test_every_file_that_the_walk_names_is_there() -> None:
    text = re.sub(r"```.*?```", "", PAGE.read_text(), flags=re.DOTALL)
    assert [word for word in lost(text) if "/" in word] == []


def test_what_is_not_there_is_found() -> None:
    assert lost("a row in `ROWS` of `failstop/policy/no_such.py`, then `nowhere/`") == [
        "failstop/policy/no_such.py",
        "nowhere/",
        "ROWS",
    ]

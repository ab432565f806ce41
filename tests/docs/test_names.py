"""Names in the pages exist: attributes of the API, settings, and the messages that they help with."""

from __future__ import annotations

import ast
import fnmatch
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import AsyncRobot, Robot
from failstop.api import snapshot
from failstop.fleet.settings import BY_KEY as OF_FLEET
from failstop.policy.causes import BY_NUMBER
from failstop.policy.settings import BY_KEY
from tests.support import rooms
from tests.support.pages import PAGES, ROOT
from tests.support.starting import nodes

TROUBLE = ROOT / "docs" / "troubleshooting.md"
KEYS = {*BY_KEY, *OF_FLEET}
SECTIONS = {key.partition(".")[0] for key in KEYS} - {"robot"}
"""Sections of the settings. `robot` is none here: pages call the API's object so."""
FILES = ("md", "py", "toml")
OF_MESSAGES = ("api", "board", "config", "doctor", "files", "messages", "policy", "procs/rights", "shm", "supervisor")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_robot_has_what_is_called_of_it(page: Path) -> None:
    named = set(re.findall(r"\brobot\.([a-z_]+)\(", page.read_text()))
    assert {name for name in named if not hasattr(Robot, name) and not hasattr(AsyncRobot, name)} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_snapshot_has_what_is_named_of_it(page: Path) -> None:
    for kind, name in re.findall(r"\b(State|Stop|Block|Imu|ArmState)\.([A-Za-z_]+)", page.read_text()):
        of = getattr(snapshot, kind)
        assert hasattr(of, name) or name in of.__dataclass_fields__, f"{kind}.{name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_setting_that_is_named_is_one(page: Path) -> None:
    """A star stands for anything."""
    named = re.findall(r"`([a-z]+)\.([a-z_0-9*]+)", page.read_text())
    keys = [f"{section}.{name}" for section, name in named if section in SECTIONS and name not in FILES]
    assert [key for key in keys if not fnmatch.filter(KEYS, key)] == []


@functools.cache
def messages() -> tuple[str, ...]:
    """Every text that the service and its API are made with."""
    return tuple(_messages())


def _messages() -> Iterator[str]:
    yield from (kind.template for kind in BY_NUMBER.values())
    for room in OF_MESSAGES:
        for path in rooms.modules(room):
            for node in nodes(ast.parse(path.read_text())):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield node.value


def helped_with() -> list[str]:
    """The messages that the page of troubles quotes: first cells of its tables, heads of its lists."""
    cells = [line.split("|")[1] for line in TROUBLE.read_text().splitlines() if line.startswith("| ") and "`" in line]
    heads = re.findall(r"^- \*\*(.*?)\*\*", TROUBLE.read_text(), re.MULTILINE)
    return [quoted for text in (*cells, *heads) for quoted in re.findall(r"`([^`]+)`", text)]


@pytest.mark.parametrize("quoted", helped_with())
def test_a_message_that_is_helped_with_is_one(quoted: str) -> None:
    """Word for word, but for what differs from case to case (CAPITALS, `...`, the name of a process)."""
    if hasattr(Robot, quoted):
        return
    for part in re.split(r"\.\.\.|\b[A-Z]{3,}\b|/dev/|\b(?:gate|port_owner|supervisor)\b|: ", quoted):
        words = part.strip()
        assert any(words in text for text in messages()), words


def test_the_page_of_troubles_helps_with_something() -> None:
    assert len(helped_with()) > 10

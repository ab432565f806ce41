"""The page of all commands is what their parsers say, and leaves none out."""

from __future__ import annotations

from pathlib import Path

from failstop.cli import main as cli
from failstop_lab.pages import commands

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "reference" / "commands.md"


def test_the_page_is_that_of_the_parsers() -> None:
    assert PAGE.read_text() == commands.page(), "renew it: make docs"


def test_every_command_is_on_it_with_examples() -> None:
    parts = PAGE.read_text().split("\n### ")
    for name in cli.COMMANDS:
        found = [part for part in parts if part.startswith((f"failstop {name}\n", f"failstop {name} "))]
        assert found, name
        assert "\nfailstop " in found[0] or "\n\nThe same as " in found[0], name

"""The page of all commands is what their parsers say, and leaves none out."""

from __future__ import annotations

import argparse
from pathlib import Path

from failstop.cli import main as cli
from failstop_lab.pages import commands, man

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


def test_its_head_names_the_commands_of_the_laboratory() -> None:
    head = PAGE.read_text().partition("\n## ")[0]
    for name in cli.COMMANDS:
        assert (f"`{name}`" in head) is cli.is_laboratory(name), name


def test_a_value_that_an_option_may_go_without_is_in_brackets() -> None:
    parser = argparse.ArgumentParser(prog="failstop box", description="a box")
    parser.add_argument("--usb", nargs="?", metavar="PLACE", help="where")
    parser.add_argument("--device", metavar="LINK", help="which")
    page = "\n".join(commands.command(parser))
    assert "| `--usb [PLACE]` | where |" in page
    assert "| `--device LINK` | which |" in page
    assert "\\fI[PLACE]\\fR" in "\n".join(man.command(parser))

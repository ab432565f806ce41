"""The help of the command line: every command in one group, examples that its own parser accepts, and a quick start."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from failstop.cli import main as cli
from failstop.policy.setting import UNITS
from failstop_lab.pages import completion, man
from tests.support.commands import FAILSTOP
from tests.support.pages import commands_in

COLUMNS = 80


def test_the_help_shows_every_command_by_purpose(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    assert sum(map(len, cli.GROUPS.values())) == len(cli.COMMANDS), "each command once"
    for title, names in cli.GROUPS.items():
        assert f"\n{title}:\n" in text
        for name in names:
            assert (f"\n  {name} " in text) == (name not in cli.HIDDEN)
    assert max(map(len, text.splitlines())) <= COLUMNS


@pytest.mark.parametrize("there", [True, False])
def test_a_manual_page_is_named_where_there_is_one(
    there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    page = tmp_path / "share/man/man1/failstop.1.gz"
    monkeypatch.setattr("failstop.cli.main.MAN_PAGES", ("share/man/man1/failstop.1.gz",))
    monkeypatch.setattr("failstop.cli.main.SYSTEM", str(tmp_path / "usr"))
    if there:
        page.parent.mkdir(parents=True)
        page.touch()
    assert cli.main(["--help"]) == 0
    assert ("man failstop" in capsys.readouterr().out) is there


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_examples_are_accepted_by_the_parser(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    _, module = cli.load(name)
    lines = cli.examples(module, name)
    assert len(lines) >= 2, f"{cli.COMMANDS[name][0]} needs EXAMPLES for {name}"
    for line in lines:
        assert commands_in(line), line
        for words in commands_in(line):
            parser, _ = cli.load(words[1])
            parser.parse_args(words[2:])
    assert cli.main([name, "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(line in shown for line in lines)
    assert max(map(len, shown.splitlines())) <= COLUMNS


TORN = re.compile(rf"[0-9]\n +(?:{'|'.join(map(re.escape, sorted(UNITS)))})(?![\w/])")
"""A number at the end of a line, with its unit on the next one."""


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_no_line_of_a_help_ends_between_a_number_and_its_unit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parsers = list(completion.walk(cli.load(name)[0]))
    for columns in range(60, 121):
        monkeypatch.setenv("COLUMNS", str(columns))
        for parser in parsers:
            assert not TORN.findall(parser.format_help()), (parser.prog, columns)


@pytest.mark.parametrize(
    ("word", "meant"),
    [("enabel", "enable"), ("Status", "status"), ("telop", "teleop"), ("stats", "status"), ("earthquake", "")],
)
def test_a_mistyped_command_is_answered_with_what_was_meant(
    word: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([word]) == 1
    question = f"did you mean `failstop {meant}`? " if meant else ""
    assert capsys.readouterr().err == f"failstop: no command {word!r}; {question}`failstop --help` lists them\n"


def test_words_that_make_no_sense_are_an_error_and_no_refusal(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["drive", "fast"]) == 1
    assert "usage: failstop drive" in capsys.readouterr().err
    assert cli.main(["help", "drive"]) == 0
    assert "m/s forward" in capsys.readouterr().out


def test_the_help_needs_one_parser_and_the_usage_none() -> None:
    """Imports are the start-up's cost."""
    code = """
import sys
from failstop.cli import main as cli
cli.main(sys.argv[1:])
print(*(name for name in sys.modules if name == 'argparse' or name.startswith('failstop.cli.commands.')))
"""

    def imported(*words: str) -> list[str]:
        command = [sys.executable, "-c", code, *words]
        result = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
        return result.stdout.splitlines()[-1].split()

    assert imported("--help") == []
    assert set(imported("drive", "--help")) == {"argparse", "failstop.cli.commands.requests"}


def test_the_help_is_there_at_once() -> None:
    """The best of five: 22 ms on a quiet 2-core machine, a good part of it the interpreter's own start."""
    best_s = float("inf")
    for _ in range(5):
        begun_s = time.monotonic()
        subprocess.run([*FAILSTOP, "--help"], capture_output=True, timeout=20, check=True)
        best_s = min(best_s, time.monotonic() - begun_s)
    assert best_s < 0.5


def test_the_manual_has_the_commands_of_commands() -> None:
    parser = argparse.ArgumentParser(prog="failstop box", description="a box")
    below = parser.add_subparsers(dest="verb")
    show = below.add_parser("show", help="tell the story")
    show.add_argument("id", nargs="?", default="last", metavar="ID", help="which (default: %(default)s)")
    show.add_argument("-o", "--output", metavar="FILE", required=True)
    show.add_argument("--hidden", help=argparse.SUPPRESS)
    box, child = completion.walk(parser)
    assert "Tell the story." in man.command(child)
    assert "which (default: last)" in man.command(child)
    assert "\\fBfailstop box show\\fR \\fB\\-o\\fR, \\fB\\-\\-output\\fR \\fIFILE\\fR [\\fIID\\fR]" in man.command(
        child
    )
    assert [action.dest for action in completion.arguments(child)] == ["id", "output"]
    assert completion.arguments(box) == []

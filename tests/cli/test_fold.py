"""Lines for people: broken at words on a terminal, whole in a pipe."""

from __future__ import annotations

import os
import pty
import struct
import subprocess
import sys
import termios
from fcntl import ioctl

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli import style
from failstop.supervisor.events import LEAST_COLUMNS, fitted, fold, say
from tests.support.commands import FAILSTOP

LINE = (
    "failstop: STOP latched: stop request: hand near the wheel (failstop estop, pid 9269); stop frame written by the "
    "port owner "
    "after 27 us; next: `failstop reset`, then `failstop enable`"
)


def test_it_breaks_at_words_with_a_hanging_indent() -> None:
    rows = fold(LINE, 80, 10).split("\n")
    assert len(rows) == 3
    assert max(map(len, rows)) <= 80
    assert all(row.startswith(" " * 10) and row[10] != " " for row in rows[1:])
    assert " ".join(row.strip() for row in rows) == LINE
    assert fold(LINE, 400, 10) == LINE
    assert fold(LINE, LEAST_COLUMNS - 1, 10) == LINE, "a terminal too narrow for an indent breaks the line itself"
    assert "\n" in fold(LINE, LEAST_COLUMNS, 10)


def test_a_command_stays_whole_where_it_fits() -> None:
    command = "`failstop incident show 20261121-111154-gate-hangs`"
    rows = fold(f"failstop: incident saved, see for what came before it {command}, and so on", 70, 10).split("\n")
    assert any(f"{command}," in row for row in rows)
    long = f"`{'word ' * 30}`"
    assert max(map(len, fold(f"failstop: {long}", 60, 10).split("\n"))) <= 60
    assert fold("failstop: one ` alone, and a text that is longer than the line is", 40, 2).count("\n") == 1


X, Y = "x" * 20, "y" * 19
COMMAND = "`failstop show first-and-last`"
"""A word as long as a line of 40 has room behind an indent of 10."""


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        (f"{X} {Y} and", [f"{X} {Y}", "and"]),
        (f"{X} {Y}y and", [X, f"{Y}y and"]),
        (f"{X} {COMMAND}", [X, COMMAND]),
        (f"{X} {COMMAND}.", [f"{X} `failstop show", "first-and-last`."]),
        (f"{X}  two spaces {Y}", [f"{X}  two spaces", Y]),
        (f" {X}{Y}", [f" {X}{Y}"]),
        (f"  {X} {Y}", [f"  {X}", Y]),
    ],
)
def test_a_line_is_filled_to_its_last_column_and_keeps_its_spaces(text: str, rows: list[str]) -> None:
    assert fold(text, 40, 10).split("\n" + " " * 10) == rows


@given(st.text(alphabet="ab `\u00e4", max_size=300), st.integers(40, 100), st.integers(0, 12))
def test_nothing_is_lost(text: str, width: int, indent: int) -> None:
    found = fold(text, width, indent)
    assert "".join(found.split()) == "".join(text.split())
    if max(map(len, text.split(" "))) <= width - indent:
        assert max(map(len, found.split("\n"))) <= width


def _terminal(width: int) -> tuple[int, int]:
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
    return ours, theirs


def test_only_on_a_terminal() -> None:
    ours, theirs = _terminal(60)
    reader, writer = os.pipe()
    try:
        assert fitted(LINE, writer) == fitted(LINE, -1) == LINE
        assert max(map(len, fitted(LINE, theirs).split("\n"))) <= 60
    finally:
        for fd in (ours, theirs, reader, writer):
            os.close(fd)


def test_the_service_s_lines(capfd: pytest.CaptureFixture[str]) -> None:
    say(LINE.removeprefix("failstop: "))
    assert capfd.readouterr().err == f"{LINE}\n"
    code = f"from failstop.supervisor.events import say; say({LINE.removeprefix('failstop: ')!r})"
    ours, theirs = _terminal(80)
    try:
        subprocess.run([sys.executable, "-c", code], stderr=theirs, check=True, timeout=20)
        shown = os.read(ours, 4096).decode().replace("\r\n", "\n")
    finally:
        os.close(ours)
        os.close(theirs)
    assert shown == fold(LINE, 80, 10) + "\n"


def test_an_error_of_a_command_is_broken_at_words() -> None:
    ours, theirs = _terminal(70)
    try:
        command = [*FAILSTOP, "status", "--name", "nobody-here"]
        assert subprocess.run(command, stderr=theirs, timeout=20, check=False).returncode == 3
        shown = os.read(ours, 4096).decode().replace("\r\n", "\n")
    finally:
        os.close(ours)
        os.close(theirs)
    assert shown.count("\n") == 2
    assert "`failstop run --name nobody-here`" in shown


def test_a_command_that_is_longer_than_a_line_breaks_between_its_words() -> None:
    command = "`failstop incident show 20261121-134036-gate-died --name pix`"
    rows = style.wrap([("saved; next: ", style.PLAIN), (command, style.STRONG)], 60, 10)
    assert [style.plain(row).strip() for row in rows] == ["saved; next:", command[:49], "--name pix`"]

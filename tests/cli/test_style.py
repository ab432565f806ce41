"""Colours that can be read on any background, and lines that fit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli import style

LEGIBLE = 3.8
TERMINAL = {"TERM": "xterm-256color"}


def _luminance(red: int, green: int, blue: int) -> float:
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in (red / 255, green / 255, blue / 255)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _of_256(number: int) -> float:
    """The luminance of one of xterm's colours 16 to 255."""
    if number >= 232:
        grey = 8 + 10 * (number - 232)
        return _luminance(grey, grey, grey)
    steps = (0, 95, 135, 175, 215, 255)
    cube = number - 16
    return _luminance(steps[cube // 36], steps[cube // 6 % 6], steps[cube % 6])


@pytest.mark.parametrize("role", [style.OK, style.WARN, style.FAIL, style.DIM])
@pytest.mark.parametrize("background", [0.0, 1.0])
def test_every_colour_is_legible_on_black_and_on_white(role: str, background: float) -> None:
    """Contrast as of WCAG."""
    _, number = style.codes(TERMINAL, terminal=True)[role].split("38;5;")
    bright, dark = sorted((_of_256(int(number)), background), reverse=True)
    assert (bright + 0.05) / (dark + 0.05) >= LEGIBLE


@pytest.mark.parametrize(
    ("environ", "terminal"),
    [(TERMINAL, False), ({**TERMINAL, "NO_COLOR": "1"}, True), ({"TERM": "dumb"}, True), ({}, True)],
)
def test_no_colours_where_none_are_wanted(environ: dict[str, str], terminal: bool) -> None:
    assert style.codes(environ, terminal=terminal) == {}


def test_an_empty_no_color_is_none() -> None:
    assert style.codes({**TERMINAL, "NO_COLOR": ""}, terminal=True)


def test_paint_without_a_terminal_is_plain() -> None:
    assert style.paint("text", style.FAIL) == "text"


texts = st.text(st.characters(min_codepoint=32, max_codepoint=0x4FFF, exclude_categories=("Cc", "Cs")), max_size=60)


commands = st.text(alphabet="ab `pid1\u4e00", max_size=60)


@given(st.lists(st.tuples(texts | commands, st.sampled_from(["", style.OK])), max_size=5), st.integers(20, 90))
def test_wrapped_lines_fit_and_lose_nothing_but_spaces(line: style.Line, columns: int) -> None:
    rows = style.wrap(line, columns, 4)
    assert all(style.cells(style.plain(row)) <= columns for row in rows)
    before, after = letters(line), [letter for row in rows for letter in letters(row)]
    assert before == after


def letters(line: style.Line) -> list[tuple[str, str]]:
    return [(character, role) for text, role in line for character in text if character != " "]


@given(texts, st.integers(0, 70))
def test_cut_fits(text: str, columns: int) -> None:
    found = style.cut(text, columns)
    assert style.cells(found) <= columns
    assert found == text or not columns or found.endswith("…")


def test_a_command_is_never_broken() -> None:
    line = [("see to it, then ", ""), ("`failstop reset`", style.STRONG), (", then more", "")]
    rows = [style.plain(row) for row in style.wrap(line, 24, 2)]
    assert "  `failstop reset`, then" in rows


def test_a_table_is_aligned() -> None:
    head: style.Line = [("name", ""), (" pid", ""), ("state", "")]
    rows = style.table([head, [("gate", ""), (" 7", ""), ("up", "")], [("supervisor", ""), (" 1234", ""), ("up", "")]])
    table = ["name         pid  state", "gate           7  up", "supervisor  1234  up"]
    assert [style.plain(row) for row in rows] == table

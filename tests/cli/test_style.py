"""Colours that can be read on any background, and lines that fit."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.cli import style
from failstop.policy.setting import UNITS
from failstop.policy.settings import BY_KEY
from failstop.supervisor.events import LEAST_COLUMNS, fold
from failstop_lab.commands import on_stand, probe, prove

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


commands = st.text(alphabet="ab `pid1 ms\u4e00", max_size=60)


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


NUMBERS = ["written after 231 us", "(at 0.05 m/s)", "in 3.4 ms,", "of 2000 bytes.", "2 h 5 min", "at 90 %"]


@pytest.mark.parametrize("text", NUMBERS)
@pytest.mark.parametrize(
    "wrap", [lambda text, columns: lines_of(text, columns), lambda text, columns: fold(text, columns, 2).split("\n")]
)
def test_a_number_and_its_unit_stay_together(wrap: Callable[[str, int], list[str]], text: str) -> None:
    line = f"{'x ' * 20}{text} and more, and more, and more, and more"
    whole = re.findall(r"[0-9.]+ [^ ]+", text)
    for columns in range(LEAST_COLUMNS, len(line)):
        rows = wrap(line, columns)
        assert " ".join(row.strip() for row in rows) == line
        assert all(any(pair in row for row in rows) for pair in whole), rows
        assert max(map(len, rows)) <= columns


def lines_of(text: str, columns: int) -> list[str]:
    return [style.plain(row) for row in style.wrap([(text, style.PLAIN)], columns, 2)]


def test_a_line_is_broken_after_a_number_that_has_no_unit() -> None:
    assert lines_of("stop number 12 shown", 15) == ["stop number 12", "  shown"]
    assert lines_of("stop number 12 s", 15) == ["stop number", "  12 s"]


def test_each_setting_s_unit_is_known() -> None:
    units = {word for declared in BY_KEY.values() for word in declared.unit.split()[:1]}
    assert units - UNITS == set()


@pytest.mark.parametrize(
    "text",
    [
        prove.SAFETY.format(
            fastest="0.20 m/s, 0.35 m/s and 1.0 rad/s",
            count=120,
            minutes=7,
            device="/dev/ttyUSB0",
            word="spin",
            arm=prove.ARM_WARNING.format(reach=0.25),
            interlocks=prove.INTERLOCKS_WARNING.format(names="arm_folded, charger_off"),
        ),
        probe.WARNING.format(seconds=15, count=12, word="spin", longer="", others=probe.DRIVES_ON),
        on_stand.WARNING.format(device="/dev/ttyUSB0"),
    ],
    ids=["prove", "probe", "chaos"],
)
@pytest.mark.parametrize("columns", [40, 72, 80])
def test_a_warning_before_wheels_turn_fits_the_terminal(text: str, columns: int) -> None:
    rows = style.paragraphs(text, columns).split("\n")
    assert max(map(len, rows)) <= columns
    assert " ".join(" ".join(rows).split()) == " ".join(text.split())
    assert not any(row.strip() in (".", ",") for row in rows)
    for item in (row for row in rows if row.startswith("     ")):
        assert item[5] != " ", "behind the number"


def test_a_table_is_aligned() -> None:
    head: style.Line = [("name", ""), (" pid", ""), ("state", "")]
    rows = style.table([head, [("gate", ""), (" 7", ""), ("up", "")], [("supervisor", ""), (" 1234", ""), ("up", "")]])
    table = ["name         pid  state", "gate           7  up", "supervisor  1234  up"]
    assert [style.plain(row) for row in rows] == table

"""Placing: explains two mistakes in a settings file: a line below the wrong [table], which TOML reads as part of that
table, and a setting or table that is in the file twice. This module is imported only for a wrong settings file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from failstop.data import Data
from failstop.policy.setting import shortened

TABLE_LINE = re.compile(r"\s*\[+\s*([^]#]+?)\s*\]")
SETTING_LINE = re.compile(r"\s*([\w.\-\"' \t]+?)\s*=")
AT_LINE = re.compile(r"\(at line (\d+),")
MOST_NAMED = 4
"""The most misplaced lines that one message names."""
TWICE = ("Cannot overwrite", "Cannot declare", "Cannot redefine", "Cannot mutate")
"""How the message of Python's TOML parser begins if a key or a table is in the file twice."""


class FileLine(Data):
    """A line of a settings file that begins a table or sets a value. For a line that begins a table, `name` is
    empty."""

    number: int
    table: str
    name: str

    @property
    def whole(self) -> str:
        """The full key, for example "gate.period_s": the table, a dot and the name."""
        return ".".join(filter(None, (self.table, self.name)))


def outline(text: str) -> list[FileLine]:
    """The lines of a settings file that begin a table or set a value. A line within a multi-line text may be mistaken
    for a setting, so use this only for error messages."""
    found = []
    table = ""
    for number, line in enumerate(text.split("\n"), 1):
        if header := TABLE_LINE.match(line):
            table = _bare(header[1])
            found.append(FileLine(number, table, ""))
        elif setting := SETTING_LINE.match(line):
            found.append(FileLine(number, table, _bare(setting[1])))
    return found


def _bare(name: str) -> str:
    return re.sub(r"[\s\"']", "", name)


def meant(key: str, known: Callable[[str], bool]) -> str:
    """The setting that somebody probably meant by the unknown key `key`. For example, `board.kind` below [arm] gives
    the key `arm.board.kind`, but `board.kind` was meant. Empty if `key` is a setting, or does not end with one."""
    if known(key):
        return ""
    parts = key.split(".")
    return next((rest for at in range(1, len(parts) - 1) if known(rest := ".".join(parts[at:]))), "")


def misplaced(text: str, keys: Iterable[str], known: Callable[[str], bool]) -> str:
    """Say in words which lines are below the wrong [table], and where they belong. Empty if there are no such lines.
    `keys`: the whole key of every value that the file sets. `known`: a function that returns True if a setting with
    that key exists."""
    lines = outline(text)
    tables = {line.table: line.number for line in reversed(lines) if not line.name}
    whole = {line.whole: line for line in lines if line.name}
    found = []
    for key in keys:
        if setting := meant(key, known):
            line = whole.get(key)
            place = f"line {line.number}, " if line else ""
            table = line.table if line else key.removesuffix(f".{setting}")
            own, _, last = setting.rpartition(".")
            if own in tables:
                where = f"write it as `{last} = ...` below `[{own}]` (line {tables[own]})"
            else:
                first = min(tables.values(), default=1)
                where = f"move it above line {first}, the first [table]"
            found.append(f"{place}`{setting}` is below `[{table}]`, so it would set {key}: {where}")
    more = f"; and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    return "; ".join(found[:MOST_NAMED]) + more


def twice(text: str, problem: str) -> str:
    """Say in words what is in the file twice. `problem`: the message of the TOML parser. Empty if the message is about
    something else, or if nothing was found twice."""
    if not problem.startswith(TWICE):
        return ""
    at = AT_LINE.search(problem)
    whole = outline(text)
    lines = [line for line in whole if not at or line.number <= int(at[1])]
    if not lines:
        return ""
    *before, second = lines
    key = shortened(second.whole)
    if second.name:
        first = next((line for line in before if line.name and line.whole == second.whole), None)
        if not first:
            return ""
        told = f"line {second.number} sets {key}, which line {first.number} has set"
        set_before = {line.whole for line in lines if line.name}
        more = (line for line in whole if line.number > second.number and line.name)
        again = [line.number for line in more if line.whole in set_before]
        if again:
            return (
                f"{told}, and {len(again)} more lines up to line {again[-1]} set what is set already: keep one of each"
            )
        return f"{told}: keep one of them"
    for line in before:
        if not line.name and line.table == second.table:
            return f"line {second.number} begins [{key}], as line {line.number} has: put its settings below that line"
        if line.name and line.table != second.table and line.whole.startswith(f"{second.table}."):
            rest = shortened(line.whole[len(second.table) + 1 :])
            return (
                f"line {second.number} begins [{key}], and line {line.number} sets {shortened(line.whole)} outside it: "
                f"write that as `{rest} = ...` below [{key}]"
            )
    return ""

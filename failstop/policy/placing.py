"""Placing: explains to the person who wrote a settings file where a line belongs: a line that TOML counts to another
table, or a setting that appears twice. Imported only after a mistake."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from failstop.data import Data
from failstop.policy.setting import shortened

TABLE_LINE = re.compile(r"\s*\[+\s*([^]#]+?)\s*\]")
SETTING_LINE = re.compile(r"\s*([\w.\-\"' \t]+?)\s*=")
AT_LINE = re.compile(r"\(at line (\d+),")
MOST_NAMED = 4
"""How many misplaced lines one message names."""
TWICE = ("Cannot overwrite", "Cannot declare", "Cannot redefine", "Cannot mutate")
"""How a message of Python's TOML parser begins if a key or a table appears twice."""


class FileLine(Data):
    """A line that begins a table (`name` is empty) or sets something."""

    number: int
    table: str
    name: str

    @property
    def whole(self) -> str:
        """The key of the setting as TOML reads it."""
        return ".".join(filter(None, (self.table, self.name)))


def outline(text: str) -> list[FileLine]:
    """The lines that begin a table or set something. It reads line by line, so a line within a longer text may look
    like a setting; for a message that is good enough."""
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
    """The setting that somebody wrote with its whole name below a [table], for example `board.kind` if the key is
    `arm.board.kind`. Empty if the key is a setting itself, or contains none."""
    if known(key):
        return ""
    parts = key.split(".")
    return next((rest for at in range(1, len(parts) - 1) if known(rest := ".".join(parts[at:]))), "")


def misplaced(text: str, keys: Iterable[str], known: Callable[[str], bool]) -> str:
    """The lines that are below the wrong [table], and where they belong; empty if there are none. `keys`: what the file
    sets, by whole key; `known`: whether a setting with that key exists."""
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
    """What appears twice in the file, if the parser's `problem` says so; empty if nothing is found."""
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

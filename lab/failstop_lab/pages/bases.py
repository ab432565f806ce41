"""The table of docs/does-your-robot-stop.md, from bases.toml: a base is added by a paragraph of data."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILE = Path(__file__).with_name("bases.toml")
COLUMNS = {
    "base": "base",
    "dies": "its driver dies",
    "silent": "its driver falls silent",
    "plug": "the plug is pulled",
    "after": "what it does then",
    "shown": "shown by",
    "source": "source",
}
SHOWN = ("read in the source", "measured by ")
"""How a row begins to say who knows it."""


def rows() -> list[dict[str, str]]:
    """Every base. Raises ValueError for one that says too little, or not who knows it."""
    found: list[dict[str, Any]] = tomllib.loads(FILE.read_text("utf-8"))["base"]
    for row in found:
        if list(row) != list(COLUMNS) or not all(row.values()):
            raise ValueError(f"{FILE.name}: {row.get('base')}: each base needs {', '.join(COLUMNS)}, in this order")
        if not row["shown"].startswith(SHOWN):
            raise ValueError(f"{FILE.name}: {row['base']}: shown = {row['shown']!r}: begin with {' or '.join(SHOWN)}")
    return found


def table() -> str:
    """As Markdown."""
    head = [f"| {' | '.join(COLUMNS.values())} |", f"|{'---|' * len(COLUMNS)}"]
    cells = ([row[key].replace("|", "\\|") for key in COLUMNS] for row in rows())
    return "\n".join([*head, *(f"| **{first}** | {' | '.join(rest)} |" for first, *rest in cells)])

"""The journal's message catalog, from the tables of kinds and texts: `python -m failstop.lab.pages.catalog FILE`.

For a file FILE.md, it writes the table of docs/journal.md into it, between its two marks.

Write it again when one of the tables changes: a test compares them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from failstop.lab.pages.catalog_texts import TEXTS
from failstop.supervisor.kinds import KINDS, EventKind

HEAD = """\
# What `journalctl -x` says below an entry of failstop.
# Made from supervisor/kinds.py and failstop/lab/pages/catalog_texts.py, by `make docs`: do not edit.
# Install as /usr/lib/systemd/catalog/failstop.catalog, then run `journalctl --update-catalog`.
"""
BEGIN = "<!-- kinds: made by `python -m failstop.lab.pages.catalog docs/journal.md` -->"
END = "<!-- end of kinds -->"


def entry(kind: EventKind) -> str:
    """The catalog's entry of one kind."""
    subject, body = TEXTS[kind.name]
    return f"-- {kind.message_id}\nSubject: {subject}\nDefined-By: failstop\n\n{body}\n"


def text() -> str:
    """The whole file."""
    return "\n".join([HEAD, *map(entry, KINDS)])


def table() -> str:
    """The kinds as a Markdown table."""
    rows = ["| kind | level | its fields (`FAILSTOP_...`) | MESSAGE_ID |", "|---|---|---|---|"]
    for kind in KINDS:
        fields = ", ".join(f"`{field.upper()}`" for field in kind.fields)
        rows.append(f"| `{kind.name}` | {kind.level} | {fields} | `{kind.message_id}` |")
    return "\n".join(rows)


def with_table(page: str) -> str:
    """A page with the table of kinds between its marks."""
    head, _, rest = page.partition(BEGIN)
    return f"{head}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}"


def main(words: list[str] | None = None) -> int:
    """Write the catalog to the file that is named, or to the standard output."""
    parser = argparse.ArgumentParser(prog="python -m failstop.lab.pages.catalog", description=__doc__)
    parser.add_argument("file", nargs="?", help="the catalog, or a page FILE.md that has the two marks")
    file = parser.parse_args(words).file
    if file is None:
        sys.stdout.write(text())
    elif file.endswith(".md"):
        page = Path(file).read_text(encoding="utf-8")
        if BEGIN not in page or END not in page:
            parser.error(f"{file} has no place for the table: a line {BEGIN!r} and a line {END!r}")
        Path(file).write_text(with_table(page), encoding="utf-8")
    else:
        Path(file).write_text(text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

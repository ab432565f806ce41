"""The journal's message catalog and the table of docs/logs.md, from the tables of kinds and texts."""

from __future__ import annotations

from failstop.supervisor.kinds import EVENT_KINDS, EventKind
from failstop_lab.pages.catalog_texts import TEXTS

PAGE_HEAD = """\
# What `journalctl -x` says below an entry of failstop.
# Made from supervisor/kinds.py and lab/failstop_lab/pages/catalog_texts.py, by `make docs`: do not edit.
# Install as /usr/lib/systemd/catalog/failstop.catalog, then run `journalctl --update-catalog`.
"""


def entry(kind: EventKind) -> str:
    """The catalog's entry of one kind."""
    subject, body = TEXTS[kind.name]
    return f"-- {kind.message_id}\nSubject: {subject}\nDefined-By: failstop\n\n{body}\n"


def text() -> str:
    """The whole file."""
    return "\n".join([PAGE_HEAD, *map(entry, EVENT_KINDS)])


def table() -> str:
    """The kinds as a Markdown table."""
    rows = ["| kind | level | its fields (`FAILSTOP_...`) | MESSAGE_ID |", "|---|---|---|---|"]
    for kind in EVENT_KINDS:
        fields = ", ".join(f"`{field.upper()}`" for field in kind.fields.split())
        rows.append(f"| `{kind.name}` | {kind.level} | {fields} | `{kind.message_id}` |")
    return "\n".join(rows)

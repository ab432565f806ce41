"""The table of kinds: whole, without doubles, and the catalog is made from it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import failstop
from failstop.supervisor.kinds import EVENT_BY_NAME, EVENT_KINDS, LEVELS, EventKind
from failstop_lab.pages import catalog
from failstop_lab.pages.catalog_texts import TEXTS

ROOT = Path(failstop.__file__).resolve().parent.parent
ALWAYS = {"MESSAGE", "FAILSTOP_NAME", "FAILSTOP_EVENT"}
AGREED = {
    *("ready", "waiting", "stop", "stop_again", "stop_also", "stop_outcome", "unstill", "died", "restarting", "down"),
    *("fenced", "enabled", "disabled", "reset", "device_lost", "device_back", "link", "rights", "pad", "charger"),
    *("scan", "command", "note", "stopping", "stopped"),
}


def test_no_name_and_no_id_is_given_twice() -> None:
    assert len(EVENT_BY_NAME) == len({kind.message_id for kind in EVENT_KINDS}) == len(EVENT_KINDS)
    assert list(TEXTS) == list(EVENT_BY_NAME), "each has its text"


def test_the_kinds_that_programs_go_by_are_there() -> None:
    assert set(EVENT_BY_NAME) >= AGREED


@pytest.mark.parametrize("kind", EVENT_KINDS, ids=lambda kind: kind.name)
def test_every_kind_is_whole(kind: EventKind) -> None:
    assert re.fullmatch(r"[a-z]+(_[a-z]+)*", kind.name)
    assert re.fullmatch(r"[0-9a-f]{32}", kind.message_id)
    assert kind.level in LEVELS
    subject, body = TEXTS[kind.name]
    assert subject
    assert "\n" not in subject
    assert body.endswith((".", "@", "`")) or "Next: " in body
    assert max(map(len, body.split("\n"))) <= 120
    placed = set(re.findall(r"@([A-Z_]+)@", subject + body))
    fields = {f"FAILSTOP_{field.upper()}" for field in kind.fields.split()}
    assert placed <= ALWAYS | fields, "not in every event of the kind"


def told(path: Path) -> set[str]:
    """The kinds that a module tells of, wherever they are written as words."""
    found, text = set(), path.read_text()
    for node in ast.walk(ast.parse(text if "log(" in text or "ote(" in text else "")):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in ("log", "Note", "_note"):
                found.add(str(node.args[0].value))
    return found


def test_every_kind_is_told_somewhere_and_none_that_is_not_in_the_table() -> None:
    found = set()
    for room in ("supervisor", "procs"):
        for path in (ROOT / room).rglob("*.py"):
            found |= told(path)
    assert found == set(EVENT_BY_NAME)


def test_the_catalog_in_the_tree_is_made_from_the_table() -> None:
    written = (ROOT / "systemd" / "failstop.catalog").read_text()
    assert written == catalog.text(), "renew it: make docs"


def test_the_catalog_has_an_entry_for_each_kind() -> None:
    assert re.findall(r"^-- ([0-9a-f]{32})$", catalog.text(), re.MULTILINE) == [kind.message_id for kind in EVENT_KINDS]

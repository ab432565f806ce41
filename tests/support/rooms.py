"""Rooms: where the source of each room lies. Three are folders at the top, linked into the package."""

from __future__ import annotations

from pathlib import Path

from failstop_lab.pages.rooms import LABORATORY, LINKED, PACKAGE, ROOT, folder, imported, imports, modules

__all__ = ["CORE", "LINKED", "PACKAGE", "ROOT", "folder", "imported", "imports", "modules", "name_of", "package"]
CORE = ("files", "notify", "shm", "messages", "board", "policy", "procs", "supervisor")


def package() -> list[Path]:
    """Every file of failstop and of its laboratory, each once."""
    own = [path for path in PACKAGE.rglob("*.py") if not any(above.is_symlink() for above in path.parents)]
    return sorted([*own, *(path for room in (*LINKED, "lab") for path in modules(room))])


def name_of(path: Path) -> str:
    if path.is_relative_to(LABORATORY):
        path = ROOT / path.relative_to(LABORATORY.parent)
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] in ("failstop", "failstop_lab") else ("failstop", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

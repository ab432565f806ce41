"""Rooms: where the source of each room lies. Three are folders at the top, linked into the package."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "failstop"
LINKED = ("procs", "shm", "supervisor")
"""Rooms at the top: what the service runs as."""
CORE = ("files", "shm", "messages", "board", "policy", "procs", "supervisor")


def folder(room: str) -> Path:
    """The folder of a room of the package, or the module of that name."""
    path = ROOT / room if room.partition("/")[0] in LINKED else PACKAGE / room
    return path if path.exists() else path.with_suffix(".py")


def modules(room: str) -> list[Path]:
    """The files of a room, in order."""
    place = folder(room)
    return sorted(place.rglob("*.py")) if place.is_dir() else [place]


def package() -> list[Path]:
    """Every file of the package, each once."""
    own = [path for path in PACKAGE.rglob("*.py") if not any(above.is_symlink() for above in path.parents)]
    return sorted([*own, *(path for room in LINKED for path in modules(room))])


def name_of(path: Path) -> str:
    """The name by which a file of the package is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "failstop" else ("failstop", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

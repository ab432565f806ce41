"""Sizes: a file is short enough to be read at once."""

from __future__ import annotations

from collections.abc import Iterator

from tests.support.rooms import ROOT

MOST_LINES = 400
TOPS = ("failstop", "procs", "shm", "supervisor", "bench", "tests", "packaging", "model", "examples")
MADE = ("build", "__pycache__")
"""Folders of what is built."""


def sizes() -> Iterator[tuple[str, int]]:
    """Each file of Python and its lines; the rooms that are linked into the package count once."""
    for top in TOPS:
        for path in sorted((ROOT / top).rglob("*.py")):
            name = path.relative_to(ROOT)
            if not any(above.is_symlink() for above in (path, *path.parents)) and not set(name.parts) & set(MADE):
                yield str(name), len(path.read_text("utf-8").splitlines())


def test_no_file_has_more_lines_than_can_be_read_at_once() -> None:
    found = dict(sizes())
    assert len(found) > 800
    assert {name: lines for name, lines in found.items() if lines > MOST_LINES} == {}

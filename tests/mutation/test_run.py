"""The copy in which mutants are made."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutation.run import copy


@pytest.mark.starts
def test_every_file_of_a_copy_is_newer_than_what_was_made_of_an_earlier_one(tmp_path: Path) -> None:
    """mutmut goes on with the mutants that it has if they are newer than their source."""
    earlier, to = tmp_path / "earlier", tmp_path / "to"
    earlier.touch()
    to.mkdir()
    copy(to)
    files = {path: path.stat().st_mtime_ns for path in to.rglob("*.py")}
    assert files
    assert [path for path, made_ns in files.items() if made_ns < earlier.stat().st_mtime_ns] == []

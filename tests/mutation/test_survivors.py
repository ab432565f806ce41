"""The verdict on a run: what is judged, and what makes it fail."""

from __future__ import annotations

import re
from fnmatch import fnmatch

import pytest

from tests.mutation.explained import REASONS, Reason
from tests.mutation.rooms import ROOMS
from tests.mutation.run import ROOT, matches
from tests.mutation.survivors import NOT_CALLED, SURVIVED, Outcome, report

KILLED = 1
SOURCES = {
    str(path.relative_to(ROOT)).removeprefix("failstop/"): path.read_text()
    for room in ROOMS.values()
    for path in matches(ROOT, room.files)
}


def absent(row: Reason) -> list[str]:
    """Names in a row that none of its files has, but for the mutants' None; without any file, its path."""
    texts = [text for path, text in SOURCES.items() if fnmatch(path, row.path)]
    names = re.findall(r"(?<!\\)\b[A-Za-z_]{4,}", row.changed.replace(r"\n", " ")) if texts else [row.path]
    return [name for name in names if name != "None" and not any(name in text for text in texts)]


def test_rows_name_what_their_files_have() -> None:
    """A row with a name that is gone explains nothing, so the survivor that it was for has no row."""
    assert [(row.path, row.changed, names) for row in REASONS if (names := absent(row))] == []
    assert absent(Reason("procs/gate/core.py", r"\+\s+self\._is_gone = 1$", "")) == ["_is_gone"]
    assert absent(Reason("procs/gate/gone.py", r"\+\s+self\.epoch = 1$", "")) == ["procs/gate/gone.py"]


def outcome(function: str, code: int | None) -> Outcome:
    return Outcome("procs/nowhere.py", f"failstop.procs.nowhere.{function}__mutmut_1", code, "-    1\n+    2")


@pytest.mark.parametrize(
    ("function", "code", "fails", "text"),
    [
        ("x_take", KILLED, 0, "2 mutants judged, 0 survived"),
        ("x_take", SURVIVED, 1, "1 of them unexplained"),
        ("x_take", None, 1, "procs/nowhere.py: 1 mutants were not tried"),
        ("x_run", NOT_CALLED, 0, "nowhere.x_run: 1 mutants were not judged, because only the running service calls it"),
        ("x\u01c1Loop\u01c1run", NOT_CALLED, 1, "because no test of these rooms calls it"),
        ("x_take", NOT_CALLED, 1, "nowhere.x_take: 1 mutants were not judged, because no test of these rooms calls it"),
    ],
)
def test_a_mutant_that_nothing_has_noticed_fails_the_run_and_so_does_a_function_that_no_test_calls(
    function: str, code: int | None, fails: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A room whose tests no longer call its code would otherwise look better with every test that goes."""
    assert report([outcome("x_other", KILLED), outcome(function, code)]) == fails
    assert text in capsys.readouterr().out

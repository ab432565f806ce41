"""Memory order on AArch64: every litmus test as herd7 has judged it, and that each barrier is needed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.commands import script

ROOT = Path(__file__).resolve().parents[2]
BARRIER = ("STLR WZR,[X9]", "LDAR W10,[X9]")

explore = script(ROOT / "model" / "aarch64" / "explore.py")
TESTS = explore.litmus_tests()
NAMES = [path.stem for path in TESTS]
BARRIERS = "barrier", "barrier-exclusives"


def checked() -> dict[str, tuple[str, str]]:
    """Results of herd7 for each: the verdict, and every final state."""
    rows = [re.split(r" {2,}", line) for line in explore.CHECKED.read_text().splitlines()[2:]]
    return {name: (verdict, states) for name, verdict, states in rows}


def columns(path: Path) -> list[list[str]]:
    """The instructions of each thread."""
    rows = [line.strip(" ;").split("|") for line in path.read_text().splitlines() if line.endswith(";") and "|" in line]
    return [[cell.strip() for cell in column[1:] if cell.strip()] for column in zip(*rows, strict=True)]


def test_herd7_has_judged_these_very_tests() -> None:
    first = explore.CHECKED.read_text().split()[0]
    assert first == explore.digest(), "a litmus test was changed: run model/aarch64/check, which needs herd7"
    assert list(checked()) == NAMES


@pytest.mark.parametrize("path", TESTS, ids=NAMES)
def test_every_order_ends_as_herd7_says(path: Path) -> None:
    test = explore.Test(path)
    states = test.states()
    assert (explore.VERDICTS[test.bad(states)], explore.written(states)) == checked()[path.stem]


@pytest.mark.parametrize("name", NAMES)
def test_nothing_goes_wrong_but_in_the_controls(name: str) -> None:
    assert checked()[name][0] == ("sometimes" if "control" in name else "never")


@pytest.mark.parametrize("name", [name for name in NAMES if "control" not in name and name not in BARRIERS])
def test_each_thread_has_a_control_that_differs_by_its_barriers_alone(name: str) -> None:
    whole = columns(explore.FOLDER / f"{name}.litmus")
    assert len(whole) == 2
    for thread in range(2):
        control = columns(explore.FOLDER / f"{name}-control-P{thread}.litmus")
        assert control[1 - thread] == whole[1 - thread]
        assert control[thread] != whole[thread]
        if name == "bell":
            plain = [cell.replace("STLR", "STR").replace("LDAR", "LDR") for cell in whole[thread]]
        else:
            plain = [cell for cell in whole[thread] if cell not in BARRIER]
        assert control[thread] == plain


@pytest.mark.parametrize("name", BARRIERS)
def test_a_lock_that_is_taken_and_let_go_is_no_barrier(name: str) -> None:
    """The order of release and acquire is all that the control has changed."""
    whole = columns(explore.FOLDER / f"{name}.litmus")[0]
    control = columns(explore.FOLDER / f"{name}-control-reversed.litmus")[0]
    assert control != whole

    def turned(cell: str) -> str:
        pairs = {"CASL": "CASA", "CASA": "CASL", "LDXR": "LDAXR", "LDAXR": "LDXR", "STXR": "STLXR", "STLXR": "STXR"}
        op, space, rest = cell.partition(" ")
        return pairs.get(op, op) + space + rest

    assert control == [turned(cell) for cell in whole]


def test_the_page_names_every_test() -> None:
    page = (ROOT / "model" / "aarch64" / "README.md").read_text()
    assert [name for name in NAMES if "control" not in name and f"`{name}`" not in page] == []


@pytest.mark.parametrize(
    ("earlier", "later", "ordered"),
    [
        ("STR W1,[X1]", "LDR W2,[X2]", False),
        ("STR W1,[X1]", "STR W2,[X2]", False),
        ("LDR W1,[X1]", "LDR W2,[X2]", False),
        ("LDR W1,[X1]", "STR W2,[X2]", False),
        ("LDR W1,[X1]", "STR W1,[X2]", True),
        ("STR W1,[X1]", "LDR W2,[X1]", True),
        ("STR W1,[X1]", "STLR W2,[X2]", True),
        ("STLR W1,[X1]", "LDR W2,[X2]", False),
        ("STLR W1,[X1]", "STR W2,[X2]", False),
        ("LDAR W1,[X1]", "LDR W2,[X2]", True),
        ("LDAR W1,[X1]", "STR W2,[X2]", True),
        ("LDR W1,[X1]", "LDAR W2,[X2]", False),
        ("STR W1,[X1]", "LDAR W2,[X2]", False),
        ("STLR W1,[X1]", "LDAR W2,[X2]", True),
        ("LDAR W1,[X1]", "STLR W2,[X2]", True),
        ("CASL W1,W3,[X1]", "CASA W2,W3,[X2]", True),
        ("CASA W1,W3,[X1]", "STR W2,[X2]", True),
        ("STR W1,[X1]", "CASA W2,W3,[X2]", False),
        ("CASL W1,W3,[X1]", "LDR W2,[X2]", False),
    ],
)
def test_what_orders_two_accesses(earlier: str, later: str, ordered: bool) -> None:
    at = {"X1": "x", "X2": "y"}
    assert explore.Step(later, at).waits_for(explore.Step(earlier, at)) == ordered

"""The matrix of tests and mutants: what pytest's summary names, and what is counted."""

from __future__ import annotations

from tests.mutation.matrix import Row, failed, function, rows, whole

STOPS, TURNS = "tests/a.py::test_it_stops[two - words]", "tests/a.py::test_it_turns"
SUMMARY = f"""..F
= short test summary info =
FAILED {STOPS} - assert 1 == 2
ERROR {TURNS}
FAILED tests/a.py::test_it_turns_back - FAILED tests/a.py::test_it_waits
2 failed, 1 error in 0.10s
"""


def test_a_failed_test_is_known_by_its_whole_name() -> None:
    others = ["tests/a.py::test_it_waits", "tests/a.py::test_it", "tests/a.py::test_it_stops[two"]
    assert failed(SUMMARY, [STOPS, TURNS, *others]) == {STOPS, TURNS}


def test_a_mutant_is_named_after_its_function() -> None:
    assert function("failstop.procs.x_leave__mutmut_12") == "failstop.procs.x_leave"


def test_a_test_that_notices_nothing_alone_comes_first_with_the_test_that_notices_the_same() -> None:
    matrix = {"one": {"a", "b"}, "two": {"a", "b"}, "three": {"a"}, "four": set[str](), "five": {"b", "c"}}
    tried = {mutant: ["a", "b", "c", "d"] for mutant in matrix}
    assert rows(matrix, tried) == [
        Row(0, 0, 5, "d", "", 0),
        Row(0, 1, 5, "c", "b", 1),
        Row(0, 3, 5, "b", "a", 2),
        Row(1, 3, 5, "a", "", 0),
    ]


def test_a_test_s_parameters_are_one_test() -> None:
    assert whole([STOPS, "tests/a.py::test_it_stops[one]", TURNS]) == {"tests/a.py::test_it_stops", TURNS}

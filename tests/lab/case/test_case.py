"""The safety case has no gap: each claim is carried, each citation names one, each hazard has claims or says so."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.case.asserted import ASSERTIONS
from failstop_lab.case.assumptions import ASSUMPTIONS
from failstop_lab.case.cited import CARRIERS, TEST, Citation, citations, of_bench, of_marks, of_tests, script
from failstop_lab.case.claims import CLAIMS
from failstop_lab.case.gaps import gaps, other_bounds, uncontrolled
from failstop_lab.case.hazards import HAZARDS
from failstop_lab.faults import arm_table, table
from failstop_lab.pages.case import claims_table
from failstop_lab.pages.made import ROOT
from failstop_lab.simulate import coverage
from failstop_lab.simulate.control_runs import controls_of
from failstop_lab.simulate.controls import Mutant

SAFETY = ROOT / "docs/safety.md"
CONTROLS_PAGE = ROOT / "docs/reference/controls.md"


@pytest.fixture(scope="module")
def cited() -> list[Citation]:
    return citations(ROOT)


def test_nothing_is_missing(cited: list[Citation]) -> None:
    assert list(gaps(CLAIMS, HAZARDS, ASSUMPTIONS, cited)) == []
    assert list(other_bounds(CLAIMS, table.TABLE, arm_table.ROWS)) == []
    assert {citation.kind for citation in cited} == set(CARRIERS)


def test_a_claim_that_nothing_cites_is_a_gap(cited: list[Citation]) -> None:
    more = dataclasses.replace(CLAIMS[0], name="NEW-1")
    assert list(gaps((*CLAIMS, more), HAZARDS, ASSUMPTIONS, cited)) == [
        "the claim NEW-1 has no proof: cite it in what proves it"
    ]


def test_a_citation_of_no_claim_is_a_gap(cited: list[Citation], tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/test_new.py").write_text('@pytest.mark.claim("DEATH-1", "DEAD-1")\ndef test_new(): ...\n')
    found = list(of_tests(tmp_path))
    assert found == [Citation(TEST, "tests/test_new.py::test_new", ("DEATH-1", "DEAD-1"), "")]
    assert list(gaps(CLAIMS, HAZARDS, ASSUMPTIONS, [*cited, *found])) == [
        "tests, tests/test_new.py::test_new: cites DEAD-1, which is no claim"
    ]


def test_a_mark_that_cites_nothing_is_a_gap(cited: list[Citation], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(coverage, "NOT_TRIED", coverage.NOT_TRIED.keys() - {"cause mute"})
    assert list(gaps(CLAIMS, HAZARDS, ASSUMPTIONS, [*cited, *of_marks()])) == [
        "simulation marks, cause mute: cites no claim: name one, or say that it carries none"
    ]


def test_a_row_of_the_bench_that_cites_nothing_is_a_gap(cited: list[Citation], tmp_path: Path) -> None:
    for name in ("bench/claims.py", "docs/reference/measured.md"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text((ROOT / name).read_text("utf-8"))
    with (tmp_path / "docs/reference/measured.md").open("a") as page:
        page.write("\n| new -> stop frame | 1 ms | p99 < 2 ms | met |\n| new, for the record | 1 ms | - | |\n")
    assert list(gaps(CLAIMS, HAZARDS, ASSUMPTIONS, [*cited, *of_bench(tmp_path)])) == [
        "bench, new -> stop frame: cites no claim: name one, or say that it carries none"
    ]


def test_each_line_of_claims_fits_a_mark_or_a_row_of_the_bench() -> None:
    names = list(coverage.names())
    assert coverage.NOT_TRIED.keys() <= set(names)
    assert [line for line, _ in coverage.CLAIMS if not any(re.fullmatch(line, name) for name in names)] == []
    told, page = script(ROOT / "bench/claims.py"), (ROOT / "docs/reference/measured.md").read_text("utf-8")
    lines = [line for line, _ in told.CLAIMS] + list(told.CARRY_NONE)
    assert [line for line in lines if not re.search(rf"(?m)^\| ({line})", page)] == []


def test_each_claim_has_a_control_that_was_found() -> None:
    assert list(uncontrolled(CLAIMS, CONTROLS_PAGE.read_text("utf-8"))) == []


def test_a_claim_whose_rule_nobody_takes_out_is_a_gap() -> None:
    more = dataclasses.replace(CLAIMS[0], name="NEW-1")
    assert list(uncontrolled((*CLAIMS, more), CONTROLS_PAGE.read_text("utf-8"))) == [
        "the claim NEW-1 has no control: take out the rule that it rests on (simulate/controls.py)"
    ]


def test_a_control_that_nothing_has_found_is_a_gap() -> None:
    page = CONTROLS_PAGE.read_text("utf-8")
    (control,) = controls_of("SILENCE-1")
    assert isinstance(control, Mutant)
    lines = [line for line in page.splitlines() if not line.startswith(f"| {control.row} |")]
    gone = f"SILENCE-1: nothing has found that {control.row}: make controls"
    assert list(uncontrolled(CLAIMS, "\n".join(lines))) == [gone]
    missed = f"| {control.row} | `{control.scenario}` | NOT FOUND by 9 seeds | 60.0 |  |  | abc |"
    assert list(uncontrolled(CLAIMS, "\n".join([*lines, missed]))) == [gone]


def test_a_hazard_without_a_claim_says_that_nothing_helps(cited: list[Citation]) -> None:
    bare = dataclasses.replace(HAZARDS[0], claims=())
    assert list(gaps(CLAIMS, (bare, *HAZARDS[1:]), ASSUMPTIONS, cited)) == [
        f"the hazard {bare.name} has no claim: name one, or say that nothing helps"
    ]


def test_an_assumption_that_nothing_makes_is_a_gap(cited: list[Citation]) -> None:
    idle = dataclasses.replace(ASSUMPTIONS[0], name="IDLE", by="nobody")
    assert list(gaps(CLAIMS, HAZARDS, [*ASSUMPTIONS, idle], cited)) == [
        "nothing takes IDLE for granted: name it, or drop it"
    ]


def test_a_time_without_a_number_is_a_gap(cited: list[Citation]) -> None:
    timeless = dataclasses.replace(CLAIMS[0], says="The stop is written within its time.", bound_ms=None)
    (found,) = gaps((timeless, *CLAIMS[1:]), HAZARDS, ASSUMPTIONS, cited)
    assert found == f"the claim {timeless.name} speaks of a time and has no number: give it a bound"


def test_a_bound_is_the_latest_bar_of_the_rows_that_carry_it() -> None:
    early = [dataclasses.replace(claim, bound_ms=1.0) if claim.name == "DEATH-1" else claim for claim in CLAIMS]
    assert list(other_bounds(early, table.TABLE, arm_table.ROWS)) == ["DEATH-1 says 1.0 ms, its rows of faults 20.0 ms"]


def test_assumptions_and_assertions_name_tests_that_are_there() -> None:
    paths = [row.checked.split()[0] for row in ASSUMPTIONS if row.checked.startswith("tests/")]
    paths += [row.test for row in ASSERTIONS]
    assert len(paths) > 10
    assert [path for path in paths if not (ROOT / path).is_file()] == []


def test_each_claim_is_shown_with_a_bug_and_what_noticed_it() -> None:
    rows = [line.strip("| ").split(" | ") for line in claims_table(ROOT).splitlines() if line.startswith("| [")]
    assert len(rows) == len(CLAIMS)
    for claim, row in zip(CLAIMS, rows, strict=True):
        first, *more = controls_of(claim.name)
        assert re.fullmatch(r"after \d+ (random run|random runs|single fault|single faults)|by `test_\w+`", row[-1]), (
            row
        )
        assert row[-2].endswith(f" (1 of {1 + len(more)} bugs)") is bool(more)
        assert (first.row in row[-2]) is not (isinstance(first, Mutant) and bool(first.bug))


def of_the_page() -> Iterator[str]:
    """The sentences of the page that claim something."""
    part = SAFETY.read_text("utf-8").partition("## What is claimed")[2].partition("\n## ")[0]
    yield from (line for line in part.splitlines() if line.startswith(("- ", "|")))


def test_the_page_claims_nothing_else() -> None:
    table = claims_table(SAFETY.parents[1]).splitlines()
    assert list(of_the_page()) == [line for line in table if line.startswith("|")]

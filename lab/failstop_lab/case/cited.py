"""Citations: what in a checkout carries each claim, as each part declares it, and what it found last.

The tests are read and not imported; model and litmus tests are scripts that lie beside the package.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib.machinery
import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from failstop_lab.case import asserted
from failstop_lab.faults import arm_table, report, table
from failstop_lab.faults.fault import CLAIMS_OF, FAULT_CLASSES
from failstop_lab.simulate import coverage, witness

TEST, ASSERTION, FAULTS, MODEL, LITMUS = "tests", "assertion", "faults", "model", "litmus tests"
SIMULATION, MARK, BENCH = "simulation", "simulation marks", "bench"
CARRIERS = (TEST, ASSERTION, FAULTS, MODEL, LITMUS, SIMULATION, MARK, BENCH)
HOLDS = "holds"


@dataclasses.dataclass(frozen=True)
class Citation:
    """One thing that carries claims; one of none is a gap (gaps.py)."""

    kind: str
    """One of CARRIERS."""
    what: str
    claims: tuple[str, ...]
    last: str
    """The last finding; empty where each run of the tests says so."""


def citations(root: Path) -> list[Citation]:
    """All of a checkout. Raises OSError where a part is not there."""
    of_code = (_asserted(), _simulation(), of_marks())
    found = (of_tests(root), *of_code, _faults(root), _model(root), _litmus(root), of_bench(root))
    return [citation for part in found for citation in part]


def of_tests(root: Path) -> Iterator[Citation]:
    """Each test that has the mark `claim`. Raises ValueError for a mark whose names are no texts."""
    for path in sorted((root / "tests").rglob("test_*.py")):
        text = path.read_text("utf-8")
        if "mark.claim(" not in text:
            continue
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (names := tuple(_marked(node))):
                yield Citation(TEST, f"{path.relative_to(root)}::{node.name}", names, "")


def _marked(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[str]:
    for mark in node.decorator_list:
        if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.claim":
            yield from map(ast.literal_eval, mark.args)


def _asserted() -> Iterator[Citation]:
    for row in asserted.ASSERTIONS:
        yield Citation(ASSERTION, f"{row.says}: {row.where}", row.claims, f"made to fail by `{row.test}`")


def _faults(root: Path) -> Iterator[Citation]:
    measured = fault_rows(root)
    of_class = {event: [row.name for row in table.TABLE if row.event == event] for event in FAULT_CLASSES}
    for event, names in of_class.items():
        yield Citation(FAULTS, f"{event} ({len(names)} rows)", CLAIMS_OF[event], _found(measured, names))
    names = [row.name for row in arm_table.ROWS]
    yield Citation(FAULTS, f"the arm moves ({len(names)} rows)", arm_table.CLAIMS, _found(measured, names))


class FaultRow(NamedTuple):
    """A row of docs/reference/faults.md; times in ms, None where there is none."""

    injected: int
    missed: int
    p99_ms: float | None
    bar_ms: float | None


def fault_rows(root: Path) -> dict[str, FaultRow]:
    """The rows of docs/reference/faults.md by their names."""
    return {
        row["name"]: FaultRow(row["count"], row["missed"], row.get("p99_ms"), report.EVERY[row["name"]].bar_ms)
        for row in report.last_campaign(root)["rows"]
    }


def _found(measured: dict[str, FaultRow], names: list[str]) -> str:
    rows = [measured[name] for name in names if name in measured]
    shares = [row.p99_ms / row.bar_ms for row in rows if row.p99_ms is not None and row.bar_ms]
    latest = f", p99 at most {max(shares):.2f} of its bar" if shares else ""
    missed = sum(row.missed for row in rows)
    return f"{sum(row.injected for row in rows)} injected{f', {missed} stops missed' if missed else ''}{latest}"


def _model(root: Path) -> Iterator[Citation]:
    check = script(root / "model/check")
    found = dict(_verdicts((root / "model/checked.txt").read_text("utf-8"), r"\s+\d+\s+"))
    every = [name for name, _, expected in check.RUNS if expected == HOLDS]
    for _, name in check.PROPERTIES:
        without = [row for row, _, expected in check.RUNS if expected == name]
        held = sum(found.get(row) == HOLDS for row in every)
        missed = sum(found.get(row) == name for row in without)
        fails = f"; fails in {missed} of {len(without)} that lack a part of it" if without else ""
        claims = check.CLAIMS.get(name, ())
        yield Citation(MODEL, f"property {name}", claims, f"holds in {held} of {len(every)} variants{fails}")


def _litmus(root: Path) -> Iterator[Citation]:
    check = script(root / "model/aarch64/check")
    found = dict(_verdicts((root / "model/aarch64/checked.txt").read_text("utf-8"), r"\s+"))
    for name, verdict in found.items():
        if "control" in name or not verdict.startswith(("never", "sometimes")):
            continue
        controls = [row for row in found if row.startswith(f"{name}-control")]
        bad = sum(found[row].startswith("sometimes") for row in controls)
        last = f"goes wrong {verdict.split()[0]}; {bad} of {len(controls)} controls do"
        yield Citation(LITMUS, name, check.CLAIMS.get(name, ()), last)


def _verdicts(text: str, between: str) -> Iterator[tuple[str, str]]:
    for line in text.splitlines()[1:]:
        name, *verdict = re.split(between, line, maxsplit=1)
        if verdict:
            yield name.strip(), verdict[0].strip()


def script(path: Path) -> ModuleType:
    """A program without a suffix as a module, without a file of its byte code."""
    loader = importlib.machinery.SourceFileLoader(f"case_{path.parent.name}_{path.name}", str(path))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module


def _simulation() -> Iterator[Citation]:
    for rule, claims in witness.CLAIMS.items():
        yield Citation(SIMULATION, rule, claims, "")


def of_marks() -> Iterator[Citation]:
    """Each mark that a campaign must reach."""
    for name in coverage.names():
        if name not in coverage.NOT_TRIED:
            yield Citation(MARK, name, coverage.claims_of(name), "")


def of_bench(root: Path) -> Iterator[Citation]:
    """Each row of docs/reference/measured.md that has a bar, but for those of no claim, and what else carries one."""
    told = script(root / "bench/claims.py")
    for line in (root / "docs/reference/measured.md").read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 4 or cells[2] in ("bar", "---"):
            continue
        claims = told.claims_of(cells[0])
        if claims or not (cells[2] == "-" or told.carries_none(cells[0])):
            yield Citation(BENCH, cells[0], claims, "; ".join(filter(None, (cells[1], cells[3].strip("*")))))

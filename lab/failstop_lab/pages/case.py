"""The pages of the safety case: hazards, claims with what carries them, assumptions."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from failstop_lab.case import assumptions, cited, claims, gaps, hazards
from failstop_lab.case.cited import Citation
from failstop_lab.case.claims import Claim
from failstop_lab.faults import report

HAZARDS_HEAD = """\
# Hazards

Generated from `lab/failstop_lab/case/hazards.py` (`make docs`). Each hazard of a robot that failstop stops: how it
comes about, what failstop does, what remains, and what helps beside it. *Stopping itself* adds hazards, and so does the
tool. The claims of [safety.md](../safety.md) that answer it stand below it, each with its longest time;
[evidence.md](evidence.md) has what carries each. A robot, its load and its place have hazards of their own: this
list is where to begin, not where to end.
"""
EVIDENCE_HEAD = """\
# Evidence

Generated from the declarations of what carries each claim (`make docs`): tests by the mark `claim`, classes of
faults, properties of the [model](../how-it-is-tested.md#the-stop-protocol-in-a-model-checker),
[litmus tests](../how-it-is-tested.md#memory-order-on-arm), rules and marks of the
[simulation](../how-it-is-tested.md#the-simulated-machine) and rows of the [bench](measured.md). CI fails for a claim
that nothing carries, for a citation of no claim, for one of these rows that neither cites a claim nor is said to
carry none, for an assumption that nothing makes, for a time without a number, and for a bound that is not the latest
bar of its rows in [faults.md](faults.md).

What a fault, model, litmus test or row of the bench found last is copied from those pages, which say when and on
which machine. A test of `tests/` and a rule of the simulation found nothing wrong in the last run of CI. A mark of the
simulation is a place that `failstop simulate` must reach, and fails if it does not. A p99 of more than 1.00 of its bar
is a missed bar: [faults.md](faults.md) marks its row, and says when a bar holds.
"""
ASSUMPTIONS_HEAD = """\
# Assumptions

Generated from `lab/failstop_lab/case/assumptions.py` (`make docs`): what model, litmus tests, simulation, simulated
boards and prover take for granted, what happens where it is wrong, and what checks it.
"""


def hazards_page() -> str:
    """docs/reference/hazards.md."""
    lines = [HAZARDS_HEAD]
    for kind in hazards.HAZARD_CLASSES:
        lines += [f"## {kind[0].upper()}{kind[1:]}", ""]
        for row in hazards.HAZARDS:
            if row.kind == kind:
                carried = ", ".join(_soon(claims.BY_NAME[name]) for name in row.claims) or "none"
                lines += [f"### {row.name}: {row.what}", "", f"- *Comes of*: {row.how}.", f"- *failstop*: {row.does}."]
                lines += [f"- *Remains*: {row.remains}.", f"- *Helps*: {row.helps}.", f"- *Claims*: {carried}.", ""]
    return "\n".join(lines[:-1]) + "\n"


def _soon(claim: Claim) -> str:
    return _link(claim) if claim.bound_ms is None else f"{_link(claim)} ({claim.bound_ms:g} ms)"


def _link(claim: Claim, folder: str = "") -> str:
    """The claim on the page of evidence. `folder`: where that page is, from the page with the link."""
    return f"[{claim.name}]({folder}evidence.md#{claim.name.lower()})"


def claims_table(root: Path) -> str:
    """The table of docs/safety.md, and how the last campaign of a checkout found its times."""
    lines = ["| | claim | p99, at most | counted |", "|---|---|---|---|"]
    for claim in claims.CLAIMS:
        bound = "" if claim.bound_ms is None else f"{claim.bound_ms:g} ms"
        lines.append(f"| {_link(claim, 'reference/')} | {claim.says} | {bound} | {claim.counted} |")
    found = report.result_of((root / "docs/reference/faults.md").read_text("utf-8"))
    kept = report.kept(report.EVERY, {row["name"]: row for row in found["rows"]})
    day, count, missed = found["machine"]["date"], found["count"], found["missed"]
    lines += ["", f"In the last campaign ({day}, {count} faults) {kept}; {missed} stops were missed."]
    return "\n".join(lines)


def evidence_page(root: Path) -> str:
    """docs/reference/evidence.md of a checkout."""
    by_claim: dict[str, list[Citation]] = defaultdict(list)
    for citation in cited.citations(root):
        for name in citation.claims:
            by_claim[name].append(citation)
    lines = [EVIDENCE_HEAD]
    for claim in claims.CLAIMS:
        taken = gaps.taken_by(by_claim[claim.name], assumptions.ASSUMPTIONS)
        assumed = f"*Assumes* {', '.join(map(_linked, claim.assumes))}."
        if besides := [_linked(name) for name in taken if name not in claim.assumes]:
            assumed += f" *Its proofs assume* {', '.join(besides)}."
        lines += [f"## {claim.name}", "", claim.says, ""]
        lines += [f"*Falsified by* {claim.falsified}. {assumed}", ""]
        lines += ["| carried by | | found last |", "|---|---|---|"]
        carried = sorted(by_claim[claim.name], key=lambda row: cited.CARRIERS.index(row.kind))
        reached = "; ".join(row.what for row in carried if row.kind == cited.MARK)
        lines += [f"| {row.kind} | {_code(row)} | {row.last} |" for row in carried if row.kind != cited.MARK]
        lines += [f"| {cited.MARK} | {reached} |  |"] * bool(reached)
        lines.append("")
    return "\n".join(lines[:-1]) + "\n"


def _linked(name: str) -> str:
    return f"[{name}](assumptions.md#{name.lower()})"


def _code(row: Citation) -> str:
    return f"`{row.what}`" if row.kind in (cited.TEST, cited.LITMUS) else row.what


def assumptions_page() -> str:
    """docs/reference/assumptions.md."""
    lines = [ASSUMPTIONS_HEAD]
    for row in assumptions.ASSUMPTIONS:
        checked = f"`{row.checked}`" if row.checked.startswith("tests/") and " " not in row.checked else row.checked
        lines += [f"## {row.name}", "", row.says, ""]
        lines += [f"- *Taken for granted by*: {row.by}.", f"- *If it is wrong*: {row.wrong}"]
        lines += [f"- *Checked by*: {checked}; {row.when}.", ""]
    return "\n".join(lines[:-1]) + "\n"

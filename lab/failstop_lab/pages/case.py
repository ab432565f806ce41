"""The pages of the safety case: hazards, claims with what carries them, assumptions."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from failstop_lab.case import assumptions, cited, claims, gaps, hazards
from failstop_lab.case.cited import Citation
from failstop_lab.case.claims import Claim
from failstop_lab.faults import report
from failstop_lab.simulate import control_runs
from failstop_lab.simulate.controls import Mutant

HAZARDS_HEAD = """\
# What can still go wrong

With this page you can check your robot against every hazard that we know: how it happens, what failstop does, what
remains, and what else helps. Stopping a robot has hazards of its own, and so has failstop itself. Your robot, its load
and its surroundings have more, so don't end your own list here.

Below each hazard are the claims of [safety.md](../safety.md) that answer it, each with its longest time.
[evidence.md](evidence.md) shows how each claim is tested. Generated from `lab/failstop_lab/case/hazards.py` (`make
docs`).
"""
EVIDENCE_HEAD = """\
# Evidence

On this page you find how each claim of [safety.md](../safety.md) is tested, what these tests found last, and what
would show the claim to be wrong. A claim is tested by

- tests in `tests/`, and rules of the [simulation](../how-it-is-tested.md#the-simulated-machine), which found nothing
  wrong in the last run of CI
- marks of the simulation, places that `failstop simulate` must reach; if it does not, it fails
- classes of [faults](faults.md), properties of the
  [model](../how-it-is-tested.md#the-stop-protocol-in-a-model-checker), [litmus
  tests](../how-it-is-tested.md#memory-order-on-arm) and rows of the [bench](measured.md). Their last results are
  copied from those pages, which say when and on which machine they were found. If a p99 is more than 1.00 of its bar,
  the bar was missed: [faults.md](faults.md) marks that row, and says when a bar holds.

Generated from the declarations of these tests (`make docs`). CI fails if a claim has no test, if a test names no claim
and does not say that it needs none, if nothing depends on an assumption, if a time has no number, or if the bound of a
claim is not the longest bar of its rows in [faults.md](faults.md).
"""
ASSUMPTIONS_HEAD = """\
# Assumptions

On this page you find what the model, the litmus tests, the simulation, the simulated boards and `failstop prove`
assume, what happens if an assumption is wrong, and what checks it. Generated from
`lab/failstop_lab/case/assumptions.py` (`make docs`).
"""


def hazards_page() -> str:
    """docs/reference/hazards.md."""
    lines = [HAZARDS_HEAD]
    for kind in hazards.HAZARD_CLASSES:
        lines += [f"## {kind[0].upper()}{kind[1:]}", ""]
        for row in hazards.HAZARDS:
            if row.kind == kind:
                carried = ", ".join(_soon(claims.BY_NAME[name]) for name in row.claims) or "none"
                lines += [f"### {row.name}: {row.what}", "", f"- *How it happens*: {row.how}."]
                lines += [f"- *What failstop does*: {row.does}.", f"- *What remains*: {row.remains}."]
                lines += [f"- *What else helps*: {row.helps}.", f"- *Claims*: {carried}.", ""]
    return "\n".join(lines[:-1]) + "\n"


def _soon(claim: Claim) -> str:
    return _link(claim) if claim.bound_ms is None else f"{_link(claim)} ({claim.bound_ms:g} ms)"


def _link(claim: Claim, folder: str = "") -> str:
    """The claim on the page of evidence. `folder`: where that page is, from the page with the link."""
    return f"[{claim.name}]({folder}evidence.md#{claim.name.lower()})"


def claims_table(root: Path) -> str:
    """The table of docs/safety.md, and how the last campaign of a checkout found its times."""
    lines = ["| | claim | p99, at most | counted | bug put in | noticed |", "|---|---|---|---|---|---|"]
    found = (root / "docs/reference/controls.md").read_text("utf-8")
    for claim in claims.CLAIMS:
        bound = "" if claim.bound_ms is None else f"{claim.bound_ms:g} ms"
        told = f"{claim.says} | {bound} | {claim.counted} | {_controlled(claim, found)}"
        lines.append(f"| {_link(claim, 'reference/')} | {told} |")
    campaign = report.last_campaign(root)
    kept = report.kept(report.EVERY, {row["name"]: row for row in campaign["rows"]})
    day, count, missed = campaign["machine"]["date"], campaign["count"], campaign["missed"]
    tried = [row["name"] for row in campaign["rows"] if row["count"]]
    timeless = sum(report.EVERY[name].bar_ms is None for name in tried)
    what = f"{count:,} faults of {len(tried)} kinds"
    lines += ["", f"In the last campaign ({day}, {what}) {kept}, and {missed or 'no'} stops were missed."]
    if timeless:
        lines.append(
            f"The other {timeless} kinds have no bar, because a healthy service answers them without a stop: it goes "
            "on driving, or refuses to enable."
        )
    return "\n".join(lines)


def _controlled(claim: Claim, found: str) -> str:
    """Two cells: what the changed code of this claim's first control does wrong, with how many other controls the claim
    has; and what noticed it."""
    first, *more = control_runs.controls_of(claim.name)
    bug = first.bug if isinstance(first, Mutant) and first.bug else first.row
    by, _ = control_runs.found_by(first, found)
    if by.startswith("`"):
        noticed = f"by `{by.strip('`').rpartition('::')[2]}`"
    else:
        noticed = f"after {by.partition(',')[0].replace('seed', 'random run')}" if by else control_runs.UNSOUGHT
    return f"{bug}{f' (1 of {1 + len(more)} bugs)' if more else ''} | {noticed}"


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
        lines += [f"*Wrong if there is* {claim.falsified}. {assumed}", ""]
        lines += ["| tested by | | last result |", "|---|---|---|"]
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
        lines += [f"- *Assumed by*: {row.by}.", f"- *If it is wrong*: {row.wrong}"]
        lines += [f"- *Checked by*: {checked}; {row.when}.", ""]
    return "\n".join(lines[:-1]) + "\n"

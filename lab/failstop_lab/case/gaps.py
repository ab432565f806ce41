"""Gaps of the safety case: what a claim, a hazard or a citation lacks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from failstop_lab.case.assumptions import Assumption
from failstop_lab.case.cited import Citation
from failstop_lab.case.claims import Claim
from failstop_lab.case.hazards import NOTHING_HELPS, Hazard
from failstop_lab.faults.arm_table import CLAIMS as ARM_CLAIMS
from failstop_lab.faults.arm_table import ArmFault
from failstop_lab.faults.fault import CLAIMS_OF, Fault
from failstop_lab.simulate import control_runs

TIMED_WORDS = ("in its time", "soon", "within", "deadline", "the moment")
"""Words of a sentence that has to have a number."""


def gaps(
    claims: Iterable[Claim], hazards: Iterable[Hazard], assumptions: Iterable[Assumption], cited: Iterable[Citation]
) -> Iterator[str]:
    """Each gap in words: what to name, or to take away."""
    claims, cited, assumptions = tuple(claims), tuple(cited), tuple(assumptions)
    known = {claim.name for claim in claims}
    taken = {row.name for row in assumptions}
    named = {name for citation in cited for name in citation.claims}
    for claim in claims:
        if claim.name not in named:
            yield f"the claim {claim.name} has no proof: cite it in what proves it"
        if claim.bound_ms is None and any(word in claim.says for word in TIMED_WORDS):
            yield f"the claim {claim.name} speaks of a time and has no number: give it a bound"
        yield from (
            f"{claim.name} assumes {name}, which is no assumption" for name in claim.assumes if name not in taken
        )
    for citation in cited:
        if not citation.claims:
            yield f"{citation.kind}, {citation.what}: cites no claim: name one, or say that it carries none"
        for name in citation.claims:
            if name not in known:
                yield f"{citation.kind}, {citation.what}: cites {name}, which is no claim"
    used = {name for claim in claims for name in claim.assumes} | set(taken_by(cited, assumptions))
    yield from (
        f"nothing takes {row.name} for granted: name it, or drop it" for row in assumptions if row.name not in used
    )
    for hazard in hazards:
        if not hazard.claims and not hazard.does.startswith(NOTHING_HELPS):
            yield f"the hazard {hazard.name} has no claim: name one, or say that nothing helps"
        yield from (f"{hazard.name} names {name}, which is no claim" for name in hazard.claims if name not in known)


def uncontrolled(claims: Iterable[Claim], page: str) -> Iterator[str]:
    """Claims whose rule nobody takes out, and rules that were taken out and not missed. `page`: what the controls have
    found last (docs/reference/controls.md)."""
    for claim in claims:
        controls = control_runs.controls_of(claim.name)
        if not controls:
            yield f"the claim {claim.name} has no control: take out the rule that it rests on (simulate/controls.py)"
        for control in controls:
            if not control_runs.found_by(control, page)[0]:
                yield f"{claim.name}: nothing has found that {control.row}: make controls"


def taken_by(cited: Iterable[Citation], assumptions: Iterable[Assumption]) -> list[str]:
    """The names of the assumptions that these kinds of proofs take for granted."""
    kinds = {citation.kind.removesuffix(" marks") for citation in cited}
    return [row.name for row in assumptions if not kinds.isdisjoint(row.by.split(", "))]


def other_bounds(claims: Iterable[Claim], faults: Iterable[Fault], arm: Iterable[ArmFault]) -> Iterator[str]:
    """Claims whose bound is not the latest bar of the rows of faults that bound it."""
    latest: dict[str, float] = {}
    for fault in faults:
        name = CLAIMS_OF[fault.event][0]
        latest[name] = max(latest.get(name, 0.0), fault.bar_ms or 0.0)
    latest[ARM_CLAIMS[0]] = max((row.bar_ms or 0.0 for row in arm), default=0.0)
    for claim in claims:
        if claim.name in latest and claim.bound_ms != latest[claim.name]:
            yield f"{claim.name} says {claim.bound_ms} ms, its rows of faults {latest[claim.name]} ms"

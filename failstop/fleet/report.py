"""Report: what became of a stop of the fleet, for people and for programs. Pure."""

from __future__ import annotations

from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG
from failstop.fleet import levels

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.cli.style import Line
    from failstop.fleet.tally import Tally


def lines(tally: Tally) -> list[Line]:
    """N of M, how far each level has come, and who is missing."""
    robots, missing = tally.robots(), tally.missing()
    if not robots:
        return [[("NO ROBOT is known to this broker, so none has confirmed", FAIL)]]
    role = FAIL if missing else OK
    counted = f"{len(robots) - len(missing)} of {len(robots)} robots have confirmed the stop"
    found: list[Line] = [[(counted, role)]]
    for level in levels.PROOFS:
        times_s = tally.times_s(level)
        slowest = f"  the last after {times_s[-1]:.2f} s" if times_s else ""
        found.append([(f"  {level:<13}", PLAIN), (f"{len(times_s)} of {len(robots)}", STRONG), (slowest, DIM)])
    for robot, level in tally.confirmed_by().items():
        if level != levels.ACKNOWLEDGED:
            found.append([(f"  {robot} confirms as {level}: its board acknowledges nothing", DIM)])
    if missing:
        found.append([("NOT confirmed, so go and look, or use the POWER SWITCH:", FAIL)])
        columns = max(len(row.robot) for row in missing)
        found += [[(f"  {row.robot:<{columns}}  ", STRONG), (row.why, PLAIN)] for row in missing]
    return found


def as_dict(tally: Tally) -> dict[str, Any]:
    """For programs."""
    missing = {row.robot: row.why for row in tally.missing()}
    robots = tally.robots()
    return {
        "confirmed": len(robots) - len(missing),
        "robots": len(robots),
        "confirmed_by": tally.confirmed_by(),
        "missing": missing,
        **{level: {"robots": tally.reached(level), "after_s": tally.times_s(level)} for level in levels.PROOFS},
    }

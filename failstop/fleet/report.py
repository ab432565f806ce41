"""Report: shows the result of a fleet stop to people and to programs. Pure."""

from __future__ import annotations

from failstop.cli import style
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN
from failstop.fleet import levels

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from failstop.cli.style import Line
    from failstop.fleet.tally import Tally


NAME_COLUMNS = 64
"""The longest part of a robot's name that is shown, in columns. Anyone who may publish on the broker could invent a
longer name."""
MOST_NAMED = 5
"""How many robots the progress line names."""


def lines(tally: Tally, doubts: Sequence[str] = (), *, listed: bool = False) -> list[Line]:
    """Return the result for people: how many robots have confirmed, how many have reached each level, and which robots
    are missing. `doubts`: reasons why more robots may exist. `listed`: True if a file names all robots."""
    robots, missing = tally.robots(), tally.missing()
    if not robots:
        return [[("This broker knows NO ROBOT, so none has confirmed", FAIL)], *_doubts(doubts)]
    role = FAIL if missing or doubts else OK
    # If there may be more robots, the count must not look like the whole fleet.
    total = f"at least {len(robots)}" if doubts else f"{len(robots)}"
    counted = f"{len(robots) - len(missing)} of {total} robots have confirmed the stop"
    found: list[Line] = [[(counted, role)]]
    for level in levels.PROOFS:
        times_s = tally.times_s(level)
        slowest = f"  the last after {times_s[-1]:.2f} s" if times_s else ""
        found.append([(f"  {level:<13}", PLAIN), (f"{len(times_s)} of {total}", STRONG), (slowest, DIM)])
    for robot, level in tally.confirmed_by().items():
        if level != levels.ACKNOWLEDGED:
            found.append([(f"  {_name(robot)} confirms as {level}, because its board can't answer", DIM)])
    found += [[(f"  {_name(robot)} has not observed that its wheels are still", WARN)] for robot in tally.unobserved()]
    if missing:
        found.append([("NOT confirmed, so go and look, or use the POWER SWITCH:", FAIL)])
        found += style.table([[("", PLAIN), (_name(row.robot), STRONG), (row.why, PLAIN)] for row in missing])
    found += _doubts(doubts)
    if not listed and not doubts:
        text = "This counts only robots that the broker still remembers. To miss none, list yours in stop.robots_file."
        found.append([(text, DIM)])
    return found


def _doubts(doubts: Sequence[str]) -> list[Line]:
    if not doubts:
        return []
    head: Line = [("There may be MORE ROBOTS, so go and look for others:", FAIL)]
    return [head, *([(f"  {doubt}", PLAIN)] for doubt in doubts)]


def _name(robot: str) -> str:
    return style.cut(robot, NAME_COLUMNS)


def progress(tally: Tally, problem: str, age_s: float) -> str:
    """Return the progress line. `problem`: a problem with the broker, or "". `age_s`: how long the sender has been
    running, s."""
    end = f"({age_s:.0f} s; Ctrl-C shows the report so far)"
    if problem:
        return f"{problem}: trying again {end}"
    missing = [_name(row.robot) for row in tally.missing()]
    total = len(tally.robots())
    counted = f"{total - len(missing)} of {total} robots have confirmed"
    if not missing:
        return f"{counted}; listening for others {end}"
    more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
    return f"{counted}; waiting for {', '.join(missing[:MOST_NAMED])}{more} {end}"


def as_dict(tally: Tally, doubts: Sequence[str] = ()) -> dict[str, Any]:
    """Return the result for programs. `complete` is True if at least one robot is known, all known robots have
    confirmed the stop, and there are no doubts. Then `failstop fleet stop` exits with 0, unless it was interrupted."""
    missing = {row.robot: row.why for row in tally.missing()}
    robots = tally.robots()
    return {
        "confirmed": len(robots) - len(missing),
        "robots": len(robots),
        "confirmed_by": tally.confirmed_by(),
        "unobserved": tally.unobserved(),
        "missing": missing,
        "doubts": list(doubts),
        "complete": bool(robots) and not missing and not doubts,
        **{level: {"robots": tally.reached(level), "after_s": tally.times_s(level)} for level in levels.PROOFS},
    }

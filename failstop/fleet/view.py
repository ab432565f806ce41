"""View: the robots of a fleet on a screen. Pure."""

from __future__ import annotations

from failstop.api import verdict, words
from failstop.cli import style
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN
from failstop.fleet import vda5050

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.cli.style import Line
    from failstop.fleet.roster import Robot

LOST = "LOST"
ENDED = "OFFLINE"
OLD_S = 40.0
"""A state older than this, of a robot that is connected, is worth a look: the interface wants one every 30 s."""
ROLES = {
    verdict.DRIVING: OK,
    verdict.STANDING: OK,
    verdict.STOPPED: WARN,
    verdict.MAY_TURN: FAIL,
    verdict.NO_SERVICE: FAIL,
    LOST: FAIL,
    ENDED: DIM,
}
ORDER = (verdict.MAY_TURN, LOST, verdict.NO_SERVICE, verdict.STOPPED, verdict.DRIVING, verdict.STANDING, ENDED)
"""The order of rows: those that need a person come first."""


def word(robot: Robot) -> str:
    """A word on its wheels; of a robot that is lost, only that."""
    if robot.connection == vda5050.OFFLINE:
        return ENDED
    return LOST if robot.lost() else robot.word or "?"


def why(robot: Robot) -> str:
    """A line on why."""
    if robot.connection == vda5050.OFFLINE:
        return "its publisher was ended; what it does now is not known here"
    if robot.lost():
        last = f"last seen {robot.word}" if robot.word else "never seen"
        return f"connection broken; {last}, and what it does now is not known here"
    return f"OBEYS NO FLEET STOP: {robot.deaf}; {robot.why}" if robot.deaf else robot.why


def counts(robots: Sequence[Robot]) -> Line:
    """How many do what."""
    found = [word(robot) for robot in robots]
    line: Line = [(f"{len(robots)} robot{'' if len(robots) == 1 else 's'}", STRONG)]
    for name in dict.fromkeys((*ORDER, *found)):
        if number := found.count(name):
            line += [("   ", PLAIN), (f"{number} {name}", ROLES.get(name, PLAIN))]
    if deaf := sum(bool(robot.deaf) for robot in robots if not robot.lost()):
        line += [("   ", PLAIN), (f"{deaf} OBEY NO FLEET STOP" if deaf > 1 else "1 OBEYS NO FLEET STOP", FAIL)]
    return line


def table(robots: Sequence[Robot], now_s: float, unix_s: float) -> list[Line]:
    """A row for each, those that need a person first."""
    heads = ("robot", "wheels", " battery", " age", "why")
    rows: list[Line] = [[(head, DIM) for head in heads]]
    ranks = {name: rank for rank, name in enumerate(ORDER)}
    for robot in sorted(robots, key=lambda robot: ranks.get(word(robot), len(ranks))):
        age_s = robot.age_s(now_s, unix_s)
        old = age_s is not None and age_s > OLD_S
        does = word(robot)
        role = FAIL if does == verdict.STOPPED and robot.latched else ROLES.get(does, PLAIN)
        rows.append(
            [
                (robot.id, PLAIN),
                (does, role),
                (f" {robot.volts:.1f} V" if robot.volts is not None else " -", PLAIN),
                (f" {words.span(age_s)}" if age_s is not None else " -", WARN if old and not robot.lost() else DIM),
                (why(robot), PLAIN if not robot.lost() else DIM),
            ]
        )
    return style.table(rows)


def lines(
    robots: Sequence[Robot], where: str, problem: str, now_s: float, unix_s: float, columns: int, rows: int
) -> list[Line]:
    """The whole screen. `problem`: with the broker; empty: none."""
    left, right = f"fleet at {where}", f"{words.clock(unix_s, unix_s)}   q quits"
    title: Line = [(left, STRONG), (" " * max(1, columns - len(left) - len(right)), PLAIN), (right, DIM)]
    head: list[Line] = [title, []]
    if problem:
        head += [[("NO BROKER  ", FAIL), (problem, STRONG)], [("what is below is old", WARN)], []]
    head += [counts(robots), []] if robots else [[("no robot is known to this broker yet", DIM)]]
    body = table(robots, now_s, unix_s) if robots else []
    foot: list[Line] = [[], [("news of a lost robot takes seconds: this shows, it guards nobody", DIM)]]
    return style.fit([*head, *body, *foot], rows)

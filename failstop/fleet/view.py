"""View: shows the robots of a fleet on a screen. Pure."""

from __future__ import annotations

from failstop.api import verdict, words
from failstop.cli import style
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN
from failstop.fleet import message

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.cli.style import Line
    from failstop.fleet.roster import Robot

LOST = "LOST"
ENDED = "OFFLINE"
OTHER = "other"
ROBOT_COLUMNS, WORD_COLUMNS, WHY_COLUMNS = 64, 20, 240
"""How wide a robot's name, the word about its wheels, and the reason may be in the table, in columns of the screen.
Anyone who may publish on the broker could send a long text, which must not push everything else off the screen."""
LEAST_ROBOT_COLUMNS = 16
OLD_S = 40.0
"""The age in seconds from which the state of a connected robot is shown as old. A robot publishes its state at least
every 30 s."""
ROLES = {
    verdict.DRIVING: OK,
    verdict.STANDING: OK,
    verdict.STOPPED: WARN,
    **dict.fromkeys((verdict.TURNING, verdict.MOVED, verdict.MAY_TURN), FAIL),
    **dict.fromkeys((verdict.STOPPING, verdict.TOLD_TO_STOP), WARN),
    **dict.fromkeys((verdict.NO_SERVICE, verdict.UNREADABLE), FAIL),
    LOST: FAIL,
    ENDED: DIM,
}
ORDER = (
    verdict.TURNING,
    verdict.MAY_TURN,
    verdict.MOVED,
    LOST,
    verdict.UNREADABLE,
    verdict.NO_SERVICE,
    verdict.STOPPING,
    verdict.STOPPED,
    verdict.TOLD_TO_STOP,
    verdict.DRIVING,
    verdict.STANDING,
    ENDED,
)
"""The order of the rows. Robots that need a person come first."""


def word(robot: Robot, now_s: float, unix_s: float) -> str:
    """Return a word about the robot's wheels, or LOST or OFFLINE if the robot is not connected. `now_s`:
    time.monotonic(). `unix_s`: Unix time."""
    if robot.connection == message.OFFLINE:
        return ENDED
    return LOST if robot.lost(now_s, unix_s) else robot.word or "?"


def why(robot: Robot, now_s: float, unix_s: float) -> str:
    """Return a line that explains the result of word()."""
    if robot.connection == message.OFFLINE:
        return "its publisher was ended, so nobody here knows what the robot does"
    if robot.lost(now_s, unix_s):
        last = f"last seen {robot.word}" if robot.word else "never seen"
        return f"{_lost(robot, now_s, unix_s)}; {last}; nobody here knows what it does now"
    found = robot.why
    if not robot.connection:
        found = f"the broker hides its connection (check the access list), so a fleet stop may miss robots; {found}"
    if robot.doubled:
        found = f"TWO ROBOTS OF THIS NAME: {robot.doubled}; {found}"
    return f"OBEYS NO FLEET STOP: {robot.deaf}; {found}" if robot.deaf else found


def _lost(robot: Robot, now_s: float, unix_s: float) -> str:
    if robot.connection == message.ONLINE:
        return f"no state for {words.span(robot.silent_s(now_s, unix_s))}, although the broker reports it as connected"
    return "connection broken" if robot.connection else "the broker reports nothing about its connection"


def counts(robots: Sequence[Robot], now_s: float, unix_s: float) -> Line:
    """Return one line with the number of robots for each word."""
    found = [word(robot, now_s, unix_s) for robot in robots]
    line: Line = [(f"{len(robots)} robot{'' if len(robots) == 1 else 's'}", STRONG)]
    for name in (*ORDER, OTHER):
        if number := sum(each == name or (name == OTHER and each not in ORDER) for each in found):
            line += [("   ", PLAIN), (f"{number} {name}", ROLES.get(name, PLAIN))]
    here = [robot for robot in robots if not robot.lost(now_s, unix_s)]
    if deaf := sum(bool(robot.deaf) for robot in here):
        line += [("   ", PLAIN), (f"{deaf} OBEY NO FLEET STOP" if deaf > 1 else "1 OBEYS NO FLEET STOP", FAIL)]
    if doubled := sum(bool(robot.doubled) for robot in here):
        line += [("   ", PLAIN), (f"{doubled} NAME{'S' * (doubled > 1)} USED TWICE", FAIL)]
    return line


def table(robots: Sequence[Robot], now_s: float, unix_s: float, columns: int | None = None) -> list[Line]:
    """Return a table with a row for each robot. Robots that need a person come first. `columns`: the screen's width. A
    robot's name gets at most a third of it, but at least LEAST_ROBOT_COLUMNS."""
    most = ROBOT_COLUMNS if columns is None else min(ROBOT_COLUMNS, max(LEAST_ROBOT_COLUMNS, columns // 3))
    heads = ("robot", "wheels", " battery", " age", "why")
    rows: list[Line] = [[(head, DIM) for head in heads]]
    ranks = {name: rank for rank, name in enumerate(ORDER)}
    for robot in sorted(robots, key=lambda robot: ranks.get(word(robot, now_s, unix_s), len(ranks))):
        age_s = robot.age_s(now_s, unix_s)
        old = age_s is not None and age_s > OLD_S
        does, lost = word(robot, now_s, unix_s), robot.lost(now_s, unix_s)
        role = FAIL if does in (verdict.STOPPED, verdict.TOLD_TO_STOP) and robot.latched else ROLES.get(does, PLAIN)
        rows.append(
            [
                (style.cut(robot.id, most), PLAIN),
                (style.cut(does, WORD_COLUMNS), role),
                (f" {robot.volts:.1f} V" if robot.volts is not None else " -", PLAIN),
                (f" {words.span(age_s)}" if age_s is not None else " -", WARN if old and not lost else DIM),
                (style.cut(why(robot, now_s, unix_s), WHY_COLUMNS), DIM if lost else PLAIN),
            ]
        )
    return style.table(rows)


def lines(
    robots: Sequence[Robot],
    where: str,
    problem: str,
    now_s: float,
    unix_s: float,
    columns: int,
    rows: int,
    blind: str = "",
) -> list[Line]:
    """Return the whole screen. `where`: the broker's address. `problem`: a problem with the broker, or "". `blind`: why
    robots may be missing, or ""."""
    left, right = f"fleet at {where}", f"{words.clock(unix_s, unix_s)}   q quits"
    title: Line = [(left, STRONG), (" " * max(1, columns - len(left) - len(right)), PLAIN), (right, DIM)]
    head: list[Line] = [title, []]
    if problem:
        head += [[("NO BROKER  ", FAIL), (problem, STRONG)], [("everything below is old", WARN)], []]
    if blind:
        head += [[("MAY LACK ROBOTS  ", FAIL), (blind, STRONG)], []]
    head += [counts(robots, now_s, unix_s), []] if robots else [[("this broker knows no robot yet", DIM)]]
    body = table(robots, now_s, unix_s, columns) if robots else []
    foot: list[Line] = [
        [],
        [("A lost robot shows up here only after seconds, so don't rely on this list for safety.", DIM)],
    ]
    return style.fit([*head, *body, *foot], rows)

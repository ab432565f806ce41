"""Told: events as lines, and which of them are asked for. Pure."""

from __future__ import annotations

import time

from failstop.api import words
from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.cli.screen import summary
from failstop.cli.style import DIM, FAIL, PLAIN, WARN
from failstop.supervisor.kinds import KINDS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.events import Event
    from failstop.cli.style import Line

ROLES = {"critical": FAIL, "error": FAIL, "warning": WARN, "notice": PLAIN, "info": DIM}
NAMES = tuple(kind.name for kind in KINDS)
KIND_COLUMNS = max(map(len, NAMES))
UNITS_S = {"s": 1, "m": 60, "min": 60, "h": 3600, "d": words.DAY_S}
FORMS = ("%H:%M", "%H:%M:%S", "%Y-%m-%d", "%Y-%m-%d %H:%M", "%Y-%m-%d %H:%M:%S")


def line(event: Event, now_s: float) -> Line:
    """One event for people: when, its kind, what was said."""
    role = ROLES.get(event.level, PLAIN)
    millis = int(event.t % 1 * 1000)
    when = f"{words.clock(event.t, now_s)}.{millis:03d}"
    # Commands in backquotes apart: they are not broken.
    text = [(part, role) for part, _ in summary.commands(event.text)]
    return [(f"{when}  ", DIM), (f"{event.kind:<{KIND_COLUMNS}}  ", role), *text]


def rows(event: Event, now_s: float, columns: int | None) -> list[Line]:
    """The same, broken to a terminal's width; None: one line, however long."""
    found = line(event, now_s)
    if columns is None:
        return [found]
    indent = sum(style.cells(text) for text, _ in found[:2])
    return style.wrap(found, columns, indent if indent < columns // 2 else 2)


def kinds(text: str) -> frozenset[str]:
    """`stop,died` as a set. Raises FailstopError for a kind that there is none of."""
    found = frozenset(word for word in text.replace(" ", "").split(",") if word)
    if unknown := sorted(found.difference(NAMES)):
        raise FailstopError(f"no kind of event is called {', '.join(unknown)}; there are {', '.join(NAMES)}")
    return found


def since(text: str, now_s: float) -> float:
    """`10m`, `1.5h`, `14:03`, `2026-11-21 14:03` as Unix time. A time of the day is the last one that has been.
    Raises FailstopError."""
    number = text.rstrip("abcdefghijklmnopqrstuvwxyz")
    unit_s = UNITS_S.get(text[len(number) :])
    if unit_s and number.replace(".", "", 1).isdigit() and number.isascii():
        return now_s - float(number) * unit_s
    for form in FORMS:
        try:
            given = time.strptime(text, form)
        except ValueError:
            continue
        if form.startswith("%Y"):
            return time.mktime(given)
        day = time.localtime(now_s)
        then_s = _local(day, given)
        return then_s if then_s <= now_s else _local(time.localtime(now_s - words.DAY_S), given)
    raise FailstopError(f"--since {text}: allowed are an age (30s, 10m, 2h, 1d) and a time (14:03, 2026-11-21 14:03)")


def _local(day: time.struct_time, clock: time.struct_time) -> float:
    """That time of that day; mktime finds out about summer time."""
    return time.mktime((*day[:3], *clock[3:6], 0, 0, -1))

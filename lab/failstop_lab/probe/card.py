"""Card: what a probe found, as text, as JSON, and as a picture to post (SVG)."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import escape

from failstop.api.words import printable
from failstop.cli import style
from failstop.cli.style import cells, cut
from failstop.files import durable
from failstop.version import VERSION
from failstop_lab.probe.judge import NEVER_S

COLUMNS = 78
TITLE = "Does this robot stop?"
FORMATS = (".txt", ".json", ".svg")
GOOD_S, BAD_S = 0.5, 2.0
"""Up to the one a time is shown green, from the other on red."""
SHARP_S = 0.03
"""A time that is not known as well as that is shown with how well it is."""
GREEN, AMBER, RED, GREY = "#1a7f37", "#bc4c00", "#cf222e", "#6e7781"
LINE, WIDTH, MARGIN, TIMES_AT, BY_AT = 34, 760, 32, 450, 570
GUARDED_AT = 330
"""Where the times at the bare board are on a card with those of the guard port."""
VALUE, REASON = 64, 92
"""Letters of a value in the picture, and of why the probe ended."""
EARLY = "Ended early: "
RECKON = "Measured with the wheels off the ground. On the ground it takes longer."


@dataclasses.dataclass(frozen=True)
class Row:
    """One way in which what drives the robot fails."""

    name: str
    words: str
    stands_s: float | None = None
    """From the failure to wheels at rest; None: they turned until the probe stopped them (`never`), or it was not
    measured."""
    by: str = ""
    """How it was judged."""
    skipped: str = ""
    """Why it was not done; empty: it was."""
    within_s: float = 0.0
    """Give or take so much: half of the time between the two reports that the rest is between."""
    cause_ns: int = 0
    """When it failed (CLOCK_MONOTONIC)."""
    unjudged: str = ""
    """Why nobody can say whether the wheels came to rest; empty: somebody has said it."""
    guarded: Row | None = None
    """The same failure through failstop's guard port; None: that was not asked for."""

    @property
    def measured(self) -> bool:
        """It was done, and somebody judged it."""
        return not (self.skipped or self.unjudged)

    @property
    def never(self) -> bool:
        """The judge saw the wheels turn until the probe stopped them."""
        return self.measured and self.stands_s is None

    @property
    def found(self) -> str:
        """For people: the time, never, or that it was not done, or not measured."""
        if not self.measured:
            return "not tried" if self.skipped else "not measured"
        return "never" if self.stands_s is None else f"{self.stands_s:.2f} s"

    @property
    def judge(self) -> str:
        """For people: who judged it, or why it was not tried."""
        return "nobody" if self.unjudged else self.by or self.skipped

    @property
    def remark(self) -> str:
        """For people: what else is to be said; empty: nothing."""
        late = f"give or take {self.within_s:.2f} s, because its reports came late" if self.within_s > SHARP_S else ""
        return self.unjudged or late

    @property
    def colour(self) -> str:
        """In the picture."""
        if not self.measured:
            return GREY
        if self.stands_s is None or self.stands_s >= BAD_S:
            return RED
        return GREEN if self.stands_s <= GOOD_S else AMBER


@dataclasses.dataclass
class Card:
    """Everything of one probe."""

    robot: str
    board: str
    firmware: str
    driver: str
    rows: list[Row] = dataclasses.field(default_factory=list)
    ended: str = ""
    """Why it ended before its end; empty: it did not."""
    begun_unix_s: float = dataclasses.field(default_factory=time.time)

    @property
    def day(self) -> str:
        """When it was made."""
        return time.strftime("%Y-%m-%d", time.gmtime(self.begun_unix_s))

    @property
    def tried(self) -> list[Row]:
        """The rows that were done."""
        return [row for row in self.rows if not row.skipped]

    @property
    def measured(self) -> list[Row]:
        """The rows that somebody judged."""
        return [row for row in self.rows if row.measured]

    @property
    def verdict(self) -> str:
        """A sentence of all of it."""
        if not self.tried:
            return "Nothing was tried."
        measured, never = self.measured, [row for row in self.rows if row.never]
        if not measured:
            return "Not measured: nobody judged whether the wheels stopped."
        left = len(self.tried) - len(measured)
        rest = f" {left} not measured." if left else ""
        if never:
            return f"It does NOT stop in {len(never)} of {len(measured)} failures: it drove on for {NEVER_S:g} s.{rest}"
        late = "It stops LATE" if self.slowest_s >= BAD_S else "It stops"
        failures = f"each of {len(measured)} failures" if len(measured) > 1 else "the one failure measured"
        return f"{late}: within {self.slowest_s:.2f} s of {failures}.{rest}"

    @property
    def guarded(self) -> bool:
        """The card has a second column, of the guard port."""
        return any(row.guarded for row in self.rows)

    def _guarded_verdict(self) -> list[str]:
        """A sentence of the second column; none without it."""
        found = [row.guarded for row in self.rows if row.guarded and row.guarded.measured]
        if not found:
            return []
        times = [row.stands_s for row in found if row.stands_s is not None]
        tried = sum(row.guarded is not None and not row.guarded.skipped for row in self.rows)
        rest = f" {tried - len(found)} not measured." if tried > len(found) else ""
        if len(times) < len(found):
            never = f"{len(found) - len(times)} of {len(found)} failures"
            return [f"Through the guard port it does NOT stop in {never}.{rest}"]
        return [f"Through the guard port it stops: within {max(times):.2f} s of each of {len(found)}.{rest}"]

    def _reckon(self) -> list[str]:
        """A sentence about the ground; none if nothing was measured."""
        return [RECKON] if self.measured else []

    @property
    def slowest_s(self) -> float:
        """The slowest stop of all rows that stopped, s."""
        return max((row.stands_s or 0.0 for row in self.tried), default=0.0)

    def heads(self) -> list[tuple[str, str]]:
        """The things that were probed."""
        pairs = [("robot", self.robot), ("board", self.board), ("firmware", self.firmware), ("driver", self.driver)]
        return [
            *((name, printable(what) or "not given") for name, what in pairs),
            ("made", f"{self.day}, failstop probe {VERSION}"),
        ]

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        head = dict(self.heads())
        rows = [
            {
                "row": row.name,
                "failure": row.words,
                "stands_s": None if row.stands_s is None else round(row.stands_s, 3),
                "never": row.never,
                "not_measured": row.unjudged,
                "judged_by": row.by,
                "skipped": row.skipped,
                "failed_at_monotonic_s": round(row.cause_ns / 1e9, 6),
                "give_or_take_s": round(row.within_s, 3),
                **({"guard_port": _times(row.guarded)} if row.guarded else {}),
            }
            for row in self.rows
        ]
        return {**head, "never_after_s": NEVER_S, "verdict": self.verdict, "ended": self.ended, "rows": rows}

    def text(self) -> str:
        """For people, in a terminal of 80 columns."""
        edge = "+" + "-" * COLUMNS + "+"
        lines = [edge, _boxed(TITLE), *(_boxed(f"{name:<9} {what}") for name, what in self.heads()), edge]
        heads = f"{'bare board':>12} {'guard port':>12}" if self.guarded else f"{'stopped after':>13}"
        wide = 31 if self.guarded else 40
        lines.append(_boxed(f"{'what failed':<{wide}} {heads}  judged by"))
        for row in self.rows:
            times = f"{row.found:>12} {row.guarded.found:>12}" if row.guarded else f"{row.found:>{len(heads)}}"
            lines.append(_boxed(f"{row.words:<{wide}} {times}  {row.judge}"))
            lines += [_boxed(f"  {row.remark}")] if row.remark else []
        lines += [edge, _boxed(self.verdict), *map(_boxed, self._guarded_verdict()), *map(_boxed, self._reckon())]
        why = [(f"{EARLY}{printable(self.ended)}", style.PLAIN)]
        ended = style.wrap(why, COLUMNS - 2, 2) if self.ended else []
        lines += [_boxed(style.plain(line)) for line in ended]
        return "\n".join([*lines, edge]) + "\n"

    def svg(self) -> str:
        """A picture."""
        y = 56
        parts = [_said(MARGIN, y, TITLE, size=26, weight="bold")]
        y += 12
        for name, what in self.heads():
            y += 24
            parts += [_said(MARGIN, y, name, colour=GREY, size=15), _said(MARGIN + 100, y, cut(what, VALUE), size=15)]
        y += 28
        parts.append(f'<line x1="{MARGIN}" y1="{y}" x2="{WIDTH - MARGIN}" y2="{y}" stroke="#d0d7de"/>')
        y += 24
        bare_at = GUARDED_AT if self.guarded else TIMES_AT
        columns = [(MARGIN, "what failed"), (bare_at, "bare board" if self.guarded else "stopped after")]
        columns += [(TIMES_AT, "guard port")] if self.guarded else []
        for x, head in (*columns, (BY_AT, "judged by")):
            parts.append(_said(x, y, head, colour=GREY, size=13))
        for row in self.rows:
            y += LINE
            parts += [
                _said(MARGIN, y, row.words, size=18),
                _said(bare_at, y, row.found, colour=row.colour, size=18, weight="bold"),
                _said(BY_AT, y, row.judge, colour=GREY, size=13),
            ]
            if also := row.guarded:
                parts.append(_said(TIMES_AT, y, also.found, colour=also.colour, size=18, weight="bold"))
            if row.remark:
                y += 20
                parts.append(_said(MARGIN, y, row.remark, colour=GREY, size=13))
        y += 26
        parts.append(f'<line x1="{MARGIN}" y1="{y}" x2="{WIDTH - MARGIN}" y2="{y}" stroke="#d0d7de"/>')
        never = any(row.never for row in self.rows)
        colour = RED if never else GREY if not self.measured else AMBER if self.slowest_s >= BAD_S else GREEN
        parts.append(_said(MARGIN, y + 36, self.verdict, colour=colour, size=20, weight="bold"))
        for line in self._guarded_verdict():
            y += 28
            parts.append(_said(MARGIN, y + 36, line, size=20, weight="bold"))
        parts += [_said(MARGIN, y + 62, line, colour=GREY, size=14) for line in self._reckon()]
        if self.ended:
            y += 26
            parts.append(_said(MARGIN, y + 62, cut(f"{EARLY}{self.ended}", REASON), colour=RED, size=14))
        height = y + 86
        frame = f'<rect width="{WIDTH}" height="{height}" rx="14" fill="#ffffff" stroke="#d0d7de"/>'
        head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" font-family="sans-serif">'
        return "\n".join([head, frame, *parts, "</svg>", ""])

    def save(self, base: str) -> list[str]:
        """Write base.txt, base.json and base.svg; returns their paths. Existing files are replaced, but a link or a
        device is not, and then none of the three is written. Raises OSError."""
        made = {".txt": self.text(), ".json": json.dumps(self.as_dict(), indent=1) + "\n", ".svg": self.svg()}
        os.makedirs(os.path.dirname(os.path.abspath(base)), exist_ok=True)
        paths = [base + end for end in FORMATS]
        for path in paths:
            durable.check_replaceable(path)
        for path, end in zip(paths, FORMATS, strict=True):
            durable.replace(path, made[end].encode())
        return paths


def _times(row: Row) -> dict[str, Any]:
    stands_s = None if row.stands_s is None else round(row.stands_s, 3)
    return {"stands_s": stands_s, "never": row.never, "not_measured": row.unjudged, "skipped": row.skipped}


def _boxed(line: str) -> str:
    shown = cut(printable(line), COLUMNS - 2)
    return f"| {shown}{' ' * (COLUMNS - 2 - cells(shown))} |"


def _said(x: int, y: int, text: str, *, colour: str = "#1f2328", size: int, weight: str = "normal") -> str:
    look = f'font-size="{size}" font-weight="{weight}" fill="{colour}"'
    return f'<text x="{x}" y="{y}" {look}>{escape(printable(text))}</text>'


def rows_in_order(rows: Sequence[Row], names: Sequence[str]) -> list[Row]:
    """The rows by these names."""
    return sorted(rows, key=lambda row: names.index(row.name))

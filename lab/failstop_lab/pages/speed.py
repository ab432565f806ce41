"""The small table of README.md: how fast a stop is, by fault. Its numbers are those of the pages on faults and
measurements, so they change with the next campaign and the next run of the bench."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path
from typing import Any, NamedTuple

from failstop.messages import layout
from failstop_lab.faults import report

FAULTS = "docs/reference/faults.md"
MEASURED = "docs/reference/measured.md"


class Line(NamedTuple):
    """A line of the table: its words, and the rows of the page on faults that it sums up."""

    fails: str
    rows: tuple[str, ...]


DRIVER_ROWS = (
    *("client-killed", "client-killed-large", "client-hung-up", "client-fails"),
    *("c-client-killed", "c-client-killed-large", "c-client-crashes", "c-client-execs", "c-client-killed-forked"),
    *("manager-killed", "manager-crashes", "guard-driver-killed", "guard-driver-closes"),
)
HUNG_ROWS = ("client-hung", "c-client-hung")
NOT_SHOWN = {
    "pad-silent": "not a program",
    "client-nan": "a program that commands nonsense",
    "client-second": "a program too many",
    "client-gamepad": "no stop",
    "manager-interrupted": "ends by itself",
    "manager-hung": "as client-hung, counted from the fault",
    "guard-driver-hung": "as client-hung, counted from the fault",
    "guard-hung": "not the user's program",
    "guard-killed": "not the user's program",
}
"""The rows of programs that drive which no line sums up, and why."""
DEATH_ROWS = tuple(f"{how}-{name}" for how in ("kill", "crash") for name in layout.PROCESS_NAMES)
DRIVING_HANGS, WATCHING_HANGS = (
    tuple(f"hang-{name}" for name in names)
    for names in ((layout.SUPERVISOR, layout.PORT_OWNER, layout.GATE), (layout.TELEMETRY, layout.STOPPER))
)
LINES = (
    Line("your program crashes or is killed", DRIVER_ROWS),
    Line("your program hangs (counted from its last command)", HUNG_ROWS),
    Line("one of failstop's own processes crashes", DEATH_ROWS),
    Line("failstop's gate, port owner or supervisor hangs", DRIVING_HANGS),
    Line("failstop's telemetry or stopper hangs", WATCHING_HANGS),
    Line(
        "you ask for a stop, or press the board's stop key or a gamepad button",
        ("stop-request", "pad-button", "board-key"),
    ),
    Line("the obstacle sensor goes silent (counted from its last reading)", ("scan-silent",)),
)
KILL_ROW = re.compile(
    r"^\| kill \w+ -> stop frame \| p50 (\S+)  p99 (\S+)  max \S+ ms(?: of \d+)?  \((\S+) and ", re.MULTILINE
)
"""A row of the page on measurements; the last group is the p50 as a multiple of the C program's."""


RUN = re.compile(
    r"\*\*The run\*\* is of (?P<date>\S+), at .*, (?P<rights>with|without) real-time rights, and the pty's bytes are "
    r"carried at (?P<carried>\S+) priority"
)
"""How the bench ran, as bench/pages.py says it on that page."""


def text(root: Path) -> str:
    """The table, with what was measured where. Raises ValueError for a page without these numbers."""
    found = report.last_campaign(root)
    rows = {row["name"]: row for row in found["rows"]}
    head = "| What happens | half of the stops within (p50) | 99 of 100 within (p99) | times tried |"
    lines = [_line(line, [rows.get(name, NOT_TRIED) for name in line.rows]) for line in LINES]
    table = [head, "|---|---|---|---|", *lines]
    return "\n".join((*table, "", _campaign(found, rows), "", _bench((root / MEASURED).read_text("utf-8"))))


NOT_TRIED: dict[str, Any] = {"count": 0, "missed": 0}
"""A row that a campaign did not have."""


def _line(line: Line, rows: list[dict[str, Any]]) -> str:
    p50, p99 = (_slowest(rows, name) for name in ("p50_ms", "p99_ms"))
    return f"| {line.fails} | {p50} | {p99} | {sum(row['count'] for row in rows)} |"


def _slowest(rows: list[dict[str, Any]], name: str) -> str:
    """A percentile of the slowest kind of fault that was injected."""
    injected = [row for row in rows if row["count"]]
    if not injected:
        return "not tried"
    if any(row["missed"] and name not in row for row in injected):
        return "missed"
    return _ms(max(row[name] for row in injected))


def _ms(value: float) -> str:
    return f"{value:.0f} ms" if value >= 10 else f"{value:.1f} ms"


def _campaign(found: dict[str, Any], rows: dict[str, dict[str, Any]]) -> str:
    machine = found["machine"]
    conditions = machine.get("conditions")
    ran = f"The service ran {conditions}." if conditions else report.UNRECORDED
    kinds = sum(1 for row in rows.values() if row["count"])
    missed, after = found["missed"], found["motion_after"]
    return _paragraphs(f"""
        Times are counted from the fault, unless the row says otherwise, until the stop has arrived at the board. A real
        serial line adds the time that the stop's bytes take, 0.6 ms at the 1 Mbaud of Hiwonder's board. If a row covers
        several kinds of fault, it shows the times of the slowest kind, and the tries of all kinds together. If a kind
        was tried 100 times or less often, its p99 is the slowest try. [How it works](#how-it-works) says what each of
        failstop's processes does.

        While the USB cable is out, the robot keeps going unless its board stops by itself. When you plug the cable in
        again, failstop sends a stop as soon as the port is back{_unplugged(rows.get("usb-drop", NOT_TRIED))}.

        All this was measured on {machine["date"]} with a simulated board, on a shared virtual machine with
        {machine["cores"]} cores. {ran} {found["count"]:,} faults of {kinds} kinds were injected at random
        while a program kept commanding. The table above shows only some of these kinds. In the whole campaign
        **{missed} stops were missed, and {after} motion commands came after a stop** ([every fault]({FAULTS})).
        """)


def _unplugged(row: dict[str, Any]) -> str:
    """How soon the stop comes once the cable is in again, as a clause."""
    if row["missed"] or not row["count"]:
        return f": of {row['count']} of these stops, {row['missed']} were missed"
    if row["count"] <= 100:
        return f": the slowest of {row['count']} of these stops took {_ms(row['p99_ms'])}"
    return f": 99 of 100 of these stops arrive within {_ms(row['p99_ms'])}"


def _bench(page: str) -> str:
    killed = [[float(number) for number in row] for row in KILL_ROW.findall(page)]
    if not killed:
        raise ValueError(f"{MEASURED} has no row of a killed process")
    p50s, p99s, ratios = zip(*killed, strict=True)
    ran = RUN.search(page)
    if not ran:
        raise ValueError(f"{MEASURED} does not say how the bench ran")
    carried = ran["carried"] == "real-time"
    why = (
        f"""It gives a real-time priority to the threads of the kernel that carry bytes to the simulated board, which
        makes its times shorter than those in the table. A real USB port needs no such threads
        ([more]({MEASURED}#where-a-stops-time-goes))."""
        if carried
        else ""
    )
    return _paragraphs(f"""
        When one of failstop's processes is killed in `make bench`, half of the stops come within {max(p50s):.1f} ms
        and 99 of 100 within {max(p99s):.1f} ms. The bench ran on {ran["date"]}, {ran["rights"]} real-time rights.
        {why}

        `make bench` also measures a small C program, which waits until a process is killed and then writes a stop.
        failstop's p50 is {min(ratios):.1f} to {max(ratios):.1f} times the p50 of that program. [Every
        measurement]({MEASURED}) is recorded, including those that are slower than we want.
        """)


def _paragraphs(text: str) -> str:
    """The text as lines of Markdown; an empty line separates its paragraphs."""
    fill = textwrap.TextWrapper(120, break_long_words=False, break_on_hyphens=False).fill
    return "\n\n".join(fill(" ".join(paragraph.split())) for paragraph in text.split("\n\n"))

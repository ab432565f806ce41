"""docs/reference/tried.md: what was tried where. `make tried` tries it again and keeps the result in tried.json."""

from __future__ import annotations

import json
from pathlib import Path

FILE = Path(__file__).with_name("tried.json")
IN_A_RECORD = ("what", "with", "machine", "result", "conditions", "day", "commit", "row")
OPENING = """\
# What was tried where

On this page you find with which systems, Pythons, ROS 2 and LeRobot versions failstop was really run, and when each
long campaign was last run. What is not in a row was never tried. Every board was simulated: no robot was available.

`make tried ROWS="versions lerobot"` tries these rows on your machine and renews them here; `make tried` lists all rows.
Each row says what the run printed, on which day and at which commit. A + means that the checkout differed from that
commit. The conditions are how long the run took, the load of the machine at its end, and its steal, which is the share
of the processors' time that the host took away.

An emulated system runs its programs by qemu-user, on the kernel of the machine in the third column, about twenty times
slower. What works there: the packages install, the service starts, a program drives, and the wheels stop when it is
killed; the simulated board is outside of the emulation. What does not work: `failstop demo` on a slow machine, because
it fails each stop that takes longer than 50 ms; real-time rights, because the first turn of a process takes longer than
the 100 ms after which the kernel kills it; boards with more than 460800 baud, which qemu 7.2 can't set; and the early
report of a death, which qemu does not pass on. Its order of memory is the machine's. So these rows say that the
packages fit, and nothing about times.

| what | with | on | result | conditions | when, at which commit | again |
|---|---|---|---|---|---|---|
"""
Attempt = dict[str, str]


def records(path: Path = FILE) -> list[Attempt]:
    """What was tried. Raises ValueError for a record that says too little."""
    found: list[Attempt] = json.loads(path.read_text("utf-8"))
    for record in found:
        if tuple(record) != IN_A_RECORD or not all(record.values()):
            raise ValueError(
                f"{path.name}: {record.get('what')}: each record needs {', '.join(IN_A_RECORD)}, in this order"
            )
    return found


def kept(new: list[Attempt], path: Path = FILE) -> None:
    """Keep new records, in the place of older ones of the same thing with the same version of it."""
    fresh = {(record["what"], record["with"]): record for record in new}
    old = {(record["what"], record["with"]): record for record in records(path)}
    rows = sorted((old | fresh).items(), key=lambda row: (row[0][0], natural(row[0][1])))
    path.write_text(json.dumps([record for _, record in rows], indent=1) + "\n", "utf-8")


def natural(text: str) -> list[tuple[int, str]]:
    """A text as people sort it: 3.9 before 3.10."""
    parts = "".join(c if c.isdigit() else f"\0{c}\0" for c in text).split("\0")
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts if part]


def page() -> str:
    """The whole page."""
    lines = [
        f"| {r['what']} | {r['with']} | {r['machine']} | {r['result']} | {r['conditions']} "
        f"| {r['day']}, {r['commit']} | `{r['row']}` |"
        for r in records()
    ]
    return OPENING + "\n".join(lines) + "\n"

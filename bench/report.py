"""Report: what a bench says on the way, its table, its JSON, its exit code."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from bench import BenchError
from bench.stats import Row
from failstop.api.errors import FailstopError
from failstop.doctor.machine import facts
from failstop_lab.sim.client import SimBoardError

VERDICT = {True: "met", False: "MISSED", None: ""}


def progress(text: str) -> None:
    """In place, for who watches; an empty text clears it."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()


def whole(part: Callable[[], list[Row]]) -> list[Row]:
    """A part's rows; of one that can't be measured, a row that says why: what was measured for half an hour is kept."""
    try:
        return part()
    except (BenchError, FailstopError, SimBoardError, OSError, subprocess.SubprocessError) as error:
        return [Row("a part that could not be measured", str(error), "that it can be", False, {})]


def end(rows: list[Row], out: str | None = None, machine: dict[str, Any] | None = None, **more: Any) -> int:
    """Print the table, write it to the file `out` with what else a run has to say, and return the exit code: 1 when a
    bar is missed. `machine`: what is to be known of this run beside the machine's own facts."""
    progress("")
    known = {**facts(), **(machine or {})}
    print(", ".join(f"{key} {value}" for key, value in known.items()), "\n")
    for row in rows:
        bar = f"\n    bar: {row.bar}  {VERDICT[row.met]}" if row.bar != "-" else ""
        print(f"{row.measure}\n    {row.result}{bar}")
    if out:
        os.makedirs(os.path.dirname(out) or ".", exist_ok=True)
        with open(out, "w", encoding="utf-8") as file:
            json.dump({"machine": known, "rows": [dataclasses.asdict(row) for row in rows], **more}, file, indent=2)
    return 1 if any(row.met is False for row in rows) else 0

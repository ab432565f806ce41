"""`python -m bench.pages bench/out/bench.json`: put a run's rows into the tables of README.md and
docs/reference/measured.md.

docs/reference/measured.md has every row of the run, in its order; README.md keeps the rows that it shows, with the
run's numbers. A row of the README that the run does not have is an error: nothing on the page may be older than the
rest."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
HEADS = {False: "| measure | measured | promised | |", True: "| measure | measured | bar | |"}
"""Of the table that shows some rows, for users, and of the one that has every row."""
VERDICT = {True: "met", False: "**missed**", None: ""}


def line(row: dict[str, Any]) -> str:
    """One row of a table."""
    return f"| {row['measure']} | {row['result']} | {row['bar']} | {VERDICT[row['met']]} |"


def renewed(page: str, rows: list[dict[str, Any]], *, every: bool) -> str:
    """The page with the run's rows in its table. Raises KeyError for a row that the run does not have."""
    head = HEADS[every]
    before, after = page.split(f"{head}\n|---|---|---|---|\n")
    shown, _, rest = after.partition("\n\n")
    found = {row["measure"]: row for row in rows}
    measures = list(found) if every else [old.split(" | ")[0].removeprefix("| ") for old in shown.splitlines()]
    table = "\n".join(line(found[measure]) for measure in measures)
    if not every:
        table = table.replace("x floor", "x C")  # the page says what C is
    return f"{before}{head}\n|---|---|---|---|\n{table}\n\n{rest}"


def main() -> int:
    """Rewrite both pages; exit code 1, with neither touched, when a row is missing."""
    parser = argparse.ArgumentParser(prog="python -m bench.pages", description=__doc__)
    parser.add_argument("run", help="JSON of a run")
    rows = json.loads(Path(parser.parse_args().run).read_text())["rows"]
    pages = {ROOT / "README.md": False, ROOT / "docs" / "reference" / "measured.md": True}
    try:
        texts = {path: renewed(path.read_text(), rows, every=every) for path, every in pages.items()}
    except KeyError as error:
        print(f"the run has no row {error}: measure it, or take it out of the README", file=sys.stderr)
        return 1
    for path, text in texts.items():
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

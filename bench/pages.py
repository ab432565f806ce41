"""`python -m bench.pages bench/out/bench.json`: put every row of a run into the table of docs/reference/measured.md.

Afterwards `make docs` renews the table of README.md, which is made from that page and from docs/reference/faults.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "reference" / "measured.md"
HEAD = "| measure | measured | bar | |\n|---|---|---|---|\n"
VERDICT = {True: "met", False: "**missed**", None: ""}


def line(row: dict[str, Any]) -> str:
    """One row of the table."""
    return f"| {row['measure']} | {row['result']} | {row['bar']} | {VERDICT[row['met']]} |"


def renewed(page: str, rows: list[dict[str, Any]]) -> str:
    """The page with the run's rows as its first table of measures, in the run's order. Raises ValueError for a page
    without one."""
    before, found, after = page.partition(HEAD)
    if not found:
        raise ValueError("the page has no table of measures")
    rest = after.partition("\n\n")[2]
    return f"{before}{HEAD}" + "\n".join(map(line, rows)) + f"\n\n{rest}"


def main() -> None:
    """Rewrite the page."""
    parser = argparse.ArgumentParser(prog="python -m bench.pages", description=__doc__)
    parser.add_argument("run", help="JSON of a run")
    rows = json.loads(Path(parser.parse_args().run).read_text())["rows"]
    PAGE.write_text(renewed(PAGE.read_text(), rows))


if __name__ == "__main__":
    main()

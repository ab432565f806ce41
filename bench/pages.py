"""`python -m bench.pages bench/out/bench.json`: put a run, with how it ran, into docs/reference/measured.md.

Afterwards `make docs` renews the table of README.md, which is made from that page and from docs/reference/faults.md.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from failstop_lab.pages import marked

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "reference" / "measured.md"
HEAD = "| measure | measured | bar | |\n|---|---|---|---|\n"
VERDICT = {True: "met", False: "**missed**", None: ""}
FOLDED = (
    (r"()[^:]+(: not as its row says)", "faults while the arm moves"),
    (r"(kill |SIG\w+ of )(?:the )?(?:supervisor|port_owner|gate|telemetry|stopper)((?: |,).* -> .*)", "each process"),
    (r"(one way, .*: ).*()", "others"),
)
"""Rows that differ in one name alone, and what their one row has in its place. The kills of each process that README
compares with the floor keep a row each, because nothing follows the name there but the arrow."""


def folded(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows, those that differ in one name alone as one row. It has the results of each, and is missed if one is."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(_group(row), []).append(row)
    return [one[0] if len(one) == 1 else _one(measure, one) for measure, one in groups.items()]


def _group(row: dict[str, Any]) -> str:
    measure = row["measure"]
    for pattern, instead in FOLDED:
        found = re.fullmatch(pattern, measure)
        if found and not measure.startswith("systemd") and not (instead == "others" and row["met"] is not None):
            return f"{found[1]}{instead}{found[2]}"
    return str(measure)


def _one(measure: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    counts = [re.fullmatch(r"(\d+) of (\d+)", row["result"]) for row in rows]
    if all(counts):
        result = " of ".join(str(sum(int(count[place]) for count in counts if count)) for place in (1, 2))
    else:
        ranks = "p50 / p99 / max" if any(" max " in row["result"] for row in rows) else "p50 / p99"
        result = f"{ranks}: {'; '.join(_each(measure, rows))}"
    verdicts = {row["met"] for row in rows} - {None}
    met = all(verdicts) if verdicts else None
    return {"measure": measure, "result": result, "bar": _bar([row["bar"] for row in rows]), "met": met}


def _each(measure: str, rows: list[dict[str, Any]]) -> Iterator[str]:
    """What each row found, after the name in which it differs."""
    found = [re.sub(r"  +", " ", row["result"]) for row in rows]
    for row, result in zip(rows, found, strict=True):
        names = set(re.findall(r"[\w+().'-]+", row["measure"])) - set(re.findall(r"[\w+().'-]+", measure))
        name = " ".join(word for word in re.findall(r"[\w+().'-]+", row["measure"]) if word in names)
        short = re.sub(r"p50 (\S+) p99 (\S+)(?: max (\S+))?", lambda t: " / ".join(filter(None, t.groups())), result)
        yield f"{name} {short}" + (" **missed**" if row["met"] is False else "")


def _bar(bars: list[str]) -> str:
    """The bars as one: a number that differs is listed for each row, in their order."""
    if len(set(bars)) == 1:
        return bars[0]
    parts = [re.split(r"(\d[\d.]*)", bar) for bar in bars]
    if len({tuple(part[::2]) for part in parts}) > 1:
        return "; ".join(bars)
    return "".join(column[0] if len(set(column)) == 1 else ", ".join(column) for column in zip(*parts, strict=True))


def line(row: dict[str, Any]) -> str:
    """One row of the table."""
    return f"| {row['measure']} | {row['result']} | {row['bar']} | {VERDICT[row['met']]} |"


def ran(machine: dict[str, Any]) -> str:
    """When a run was made and on what, as a paragraph. `machine`: the facts that the run wrote about itself."""
    rights = "with" if machine["realtime"] else "without"
    return (
        f"**The run** is of {machine['date']}, at {machine['commit'] or 'no commit'}: {machine['cores']} cores, kernel "
        f"{machine['kernel']}, Python {machine['python']}, {rights} real-time rights, and the pty's bytes are "
        f"carried at {machine['pty carriers']} priority. It took {machine['took_s']} s, and the host took away "
        f"{machine['steal']:.1%} of the processors' time. `{machine['command']}`"
    )


def renewed(page: str, run: dict[str, Any]) -> str:
    """The page with the run's rows as its first table of measures, in the run's order, and with how it ran. Raises
    ValueError for a page without one."""
    before, found, after = marked.renewed(page, "run", ran(run["machine"])).partition(HEAD)
    if not found:
        raise ValueError("the page has no table of measures")
    rest = after.partition("\n\n")[2]
    return f"{before}{HEAD}" + "\n".join(map(line, folded(run["rows"]))) + f"\n\n{rest}"


def main() -> None:
    """Rewrite the page."""
    parser = argparse.ArgumentParser(prog="python -m bench.pages", description=__doc__)
    parser.add_argument("run", help="JSON of a run")
    run = json.loads(Path(parser.parse_args().run).read_text())
    PAGE.write_text(renewed(PAGE.read_text(), run))


if __name__ == "__main__":
    main()

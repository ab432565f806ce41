"""Counts mutmut's results and shows every survivor as a diff; exit code 1 when more than 3 % survive."""

from __future__ import annotations

import sqlite3
import subprocess
import sys

MOST = 0.03


def main() -> int:
    """Read .mutmut-cache of the current directory."""
    rows = sqlite3.connect(".mutmut-cache").execute("select id, status from Mutant order by id").fetchall()
    tested = [row for row in rows if row[1] not in ("skipped", "untested")]
    survivors = [number for number, status in tested if status == "bad_survived"]
    for number in survivors:
        shown = subprocess.run(
            [sys.executable, "-m", "mutmut", "show", str(number)], capture_output=True, text=True, check=False
        )
        print("\n".join(line for line in shown.stdout.splitlines() if line[:1] in "+-"), "\n")
    share = len(survivors) / len(tested) if tested else 1.0
    print(f"{len(tested)} mutants, {len(survivors)} survived: {share:.1%}, at most {MOST:.0%} may")
    return 1 if share > MOST else 0


if __name__ == "__main__":
    sys.exit(main())

"""Findings: tests that fail at first and pass when they are tried again by themselves.

`make test` tries what failed once more, so that one late process does not hide what the rest found. A pass on the
second try is still news: `python -m tests.support.findings note` writes the names of what failed into a file before
the second try, and `show` prints those that passed then, at the very end of `make test`. CI prints that file too.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FAILED = ROOT / ".pytest_cache" / "v" / "cache" / "lastfailed"
"""Where pytest keeps the names of the tests that failed last."""
NOTED = ROOT / ".pytest_cache" / "first-try.json"
FILE = ROOT / "build" / "second-try.txt"
"""The findings of the last `make test`, one name a line; empty without any."""


def failed(path: Path) -> list[str]:
    """The names in one of these files; none where it is absent."""
    return sorted(json.loads(path.read_text())) if path.exists() else []


def start(noted: Path = NOTED, file: Path = FILE) -> None:
    """Forget the findings of an earlier run."""
    noted.unlink(missing_ok=True)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("")


def note(last: Path = FAILED, noted: Path = NOTED) -> None:
    """Remember what failed at the first try."""
    noted.parent.mkdir(parents=True, exist_ok=True)
    noted.write_text(json.dumps(sorted({*failed(noted), *failed(last)})))


def passed_then(last: Path = FAILED, noted: Path = NOTED, file: Path = FILE) -> list[str]:
    """What failed at first and passed at the second try; written to the file, too."""
    found = [name for name in failed(noted) if name not in failed(last)]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(f"{name}\n" for name in found))
    return found


def main(word: str) -> int:
    """`start`, `note` or `show`."""
    if word == "show":
        found = passed_then()
        if found:
            print(f"\nPassed on the second try only, so find out why ({FILE.relative_to(ROOT)}):")
            print("".join(f"  {name}\n" for name in found), end="")
        return 0
    {"start": start, "note": note}[word]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

"""`make lock`: the version and the hashes of everything that a release fetches, in packaging/lock.txt, for each Python.

`make release` takes nothing else, so an index that serves another file under the same name changes no package.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "packaging/lock.txt"
EXTRAS = ("fleet", "web")
"""Those of failstop's whose needs the Debian package brings along."""
OLDEST = "3.10"
HEAD = "# Made by `make lock`: what a release fetches, for each Python that failstop supports.\n"


class Locked(NamedTuple):
    """One version of a distribution, with the hashes of all its files."""

    requirement: Requirement
    hashes: tuple[str, ...]


def read(text: str) -> list[Locked]:
    """The lines of a lock: `name==version ; condition`, each with its hashes."""
    found = []
    for line in re.sub(r"\\\n", " ", text).splitlines():
        words, *hashes = re.split(r"\s--hash=", line.partition(" #")[0])
        if words.strip() and not words.startswith("#"):
            found.append(Locked(Requirement(words.strip()), tuple(one.strip() for one in hashes)))
    return found


def needed(locked: Sequence[Locked], python: str, without: Collection[str] = ()) -> str:
    """The lines for one Python, without conditions: pip judges them by the Python that it runs on."""
    where = {"python_version": python, "python_full_version": f"{python}.0"}
    return "".join(
        f"{row.requirement.name}{row.requirement.specifier} {' '.join(f'--hash={one}' for one in row.hashes)}\n"
        for row in locked
        if row.requirement.name not in without
        and (row.requirement.marker is None or row.requirement.marker.evaluate(where))
    )


def main() -> int:
    """Resolve again with uv, and write the lock."""
    uv = Path(sys.executable).with_name("uv")
    extras = [word for name in EXTRAS for word in ("--extra", name)]
    options = (
        "--quiet",
        "--universal",
        "--generate-hashes",
        "--no-header",
        "--no-annotate",
        "--no-emit-index-url",
        "--fork-strategy",
        "fewest",
    )
    words = (uv, "pip", "compile", "pyproject.toml", *extras, "--python-version", OLDEST, *options)
    done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode == 0:
        PLACE.write_text(HEAD + done.stdout)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())

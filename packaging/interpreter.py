"""`make interpreter PYTHON_VERSION=3.14`: a Python that this system lacks, from Debian's packages, for `make versions`.

No package index has interpreters, but Debian's other suites do. One is unpacked into build/pythons/VERSION, and nothing
of the system changes. It runs with the C library of its own suite, which is newer than that of most systems.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SUITES = {"3.11": "bookworm", "3.13": "trixie", "3.14": "forky"}
"""The Debian suite whose Python is of that version."""
FOLDER = "FAILSTOP_PYTHONS"
"""The environment variable that names another folder for interpreters than build/pythons."""
TOOLS = {"mmdebstrap": "mmdebstrap", "patchelf": "patchelf", "gpgv": "gpgv"}
"""Programs that it needs, each with its Debian package."""
NOT_VALID = 'Acquire::Check-Valid-Until "false"'
"""A mirror that is behind has a testing suite whose date has passed; its signature still counts."""


class InterpreterError(Exception):
    """It can't be made; the message is one line with the remedy."""


def folder() -> Path:
    """Where interpreters are unpacked."""
    return Path(os.environ.get(FOLDER, ROOT / "build/pythons"))


def place(version: str) -> Path:
    """Where the unpacked interpreter of a version is."""
    return folder() / version / f"usr/bin/python{version}"


def make(version: str) -> Path:
    """Unpack it and let it find its own libraries; returns its path. Raises InterpreterError."""
    suite = SUITES.get(version)
    if suite is None:
        raise InterpreterError(f"no Debian suite has Python {version}: there are {', '.join(SUITES)}")
    if lacking := [package for program, package in TOOLS.items() if not shutil.which(program)]:
        raise InterpreterError(f"missing {', '.join(lacking)}: apt install {' '.join(lacking)}")
    path = place(version)
    home = path.parents[2]
    shutil.rmtree(home, ignore_errors=True)
    home.parent.mkdir(parents=True, exist_ok=True)
    include = f"--include=python{version},python{version}-venv"
    _run("mmdebstrap", "--quiet", "--variant=extract", f"--aptopt={NOT_VALID}", include, suite, str(home))
    try:
        [loader] = {found.resolve() for found in home.glob("usr/lib*/ld-linux-*.so.*")}
        [libraries] = {found.parent for found in home.glob("usr/lib/*-linux-gnu/libc.so.6")}
    except ValueError:
        raise InterpreterError(f"{suite} has its C library elsewhere than in usr/lib: {home}") from None
    # The old kind of search path, which also holds for the libraries of its modules.
    _run("patchelf", "--force-rpath", "--set-rpath", str(libraries), "--set-interpreter", str(loader), str(path))
    # Debian's venv takes pip from a folder of the system, whose pip is older than this Python.
    for data in home.glob(f"usr/lib/python{version}/_sysconfigdata_*.py"):
        data.write_text(
            re.sub(r"'/usr/share/python-wheels/?'", repr(f"{home}/usr/share/python-wheels"), data.read_text())
        )
    return path


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip() or "nothing").splitlines()[-1]
        raise InterpreterError(f"{words[0]} ended with code {done.returncode} and said: {last}")


def main(version: str) -> int:
    """Make it, and print its path; exit code 1 with the reason when it can't be made."""
    try:
        print(make(version))
    except InterpreterError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

#!/usr/bin/env python3
"""Whether what failstop needs installs on another machine without a compiler: a wheel of each, for each Python.

    python packaging/wheels.py [MACHINE]        aarch64 unless said otherwise; needs the network and pip

Exit code 1 when one is missing.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
GLIBC = ("manylinux2014", "manylinux_2_17", "manylinux_2_27", "manylinux_2_28")
"""Debian 10 has glibc 2.28, every later one and Ubuntu 20.04 a newer one."""


def needed(dependencies: list[str], python: str) -> list[str]:
    """The dependencies of this Python, without their conditions: pip goes by those of its own."""
    found = [Requirement(text) for text in dependencies]
    return [
        f"{one.name}{one.specifier}"
        for one in found
        if one.marker is None or one.marker.evaluate({"python_version": python})
    ]


def missing(dependencies: list[str], python: str, machine: str, folder: str) -> list[str]:
    """Those without a wheel; the others lie in the folder."""
    platforms = [word for glibc in GLIBC for word in ("--platform", f"{glibc}_{machine}")]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    options = [
        "--only-binary=:all:",
        "--implementation",
        "cp",
        "--python-version",
        python,
        *platforms,
        "--dest",
        folder,
    ]
    return [
        one
        for one in needed(dependencies, python)
        if subprocess.run([*pip, *options, one], check=False, stderr=subprocess.DEVNULL).returncode
    ]


def main() -> int:
    """Ask for each, and print what there is."""
    machine = sys.argv[1] if len(sys.argv) > 1 else "aarch64"
    dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    wrong = 0
    for python in PYTHONS:
        with tempfile.TemporaryDirectory() as folder:
            lacking = missing(dependencies, python, machine, folder)
            wheels = sorted("-".join(path.name.split("-")[:2]) for path in Path(folder).glob("*.whl"))
        wrong += len(lacking)
        lacks = f"; NO WHEEL: {', '.join(lacking)}" if lacking else ""
        print(f"{machine}, Python {python}: {', '.join(wheels)}{lacks}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

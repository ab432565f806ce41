"""The binary interface of libfailstop, as clients/c/abi.txt records it: what it exports, how large its structs are, and
where their fields are.

`python -m tests.clients.abi` says what has changed since the file was written, and `--write` writes it, unless a
program that runs today would no longer run. `--beside REF` compares with the library of another commit, by abidiff.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from failstop_lab.pages import c_reference
from tests.support.c_client import ROOT, SOURCE

RECORDED = SOURCE / "abi.txt"
SHARED = "libfailstop.so.0"
HOW = "if the change is meant: make abi WRITE=yes"
ABIDIFF_CHANGED = 4
"""The bit of its exit code for a change that breaks nothing."""


def described(library: Path) -> str:
    """The whole text, of a library that was built in this folder."""
    lines = [*_symbols(library / SHARED), *_structs()]
    return "".join(f"{line}\n" for line in (f"soname {SHARED}", *lines))


def exported(library: Path) -> dict[str, str]:
    """The functions that a shared library exports, each with its version."""
    listed = _said("nm", "--dynamic", "--defined-only", library)
    found = (re.match(r"\S+ [TW] (\w+)(?:@@(\S+))?$", line) for line in listed)
    return {symbol[1]: symbol[2] or "" for symbol in found if symbol}


def broken(before: str, now: str) -> list[str]:
    """What would keep a program from running that was compiled with the library of `before`."""
    old, new = (dict(line.rsplit(" ", 1) for line in text.splitlines()) for text in (before, now))
    found = []
    for name, value in old.items():
        # A struct may grow, because each program says how large its own is.
        grows = name.startswith("size ") and int(new.get(name, 0)) >= int(value)
        if new.get(name) != value and not grows:
            found.append(f"{name} {value}: now {new.get(name, 'gone')}")
    return found


def _symbols(library: Path) -> Iterator[str]:
    yield from (f"symbol {name} {version}" for name, version in sorted(exported(library).items()))


def _structs() -> Iterator[str]:
    """By a program that the compiler makes, because it alone decides."""
    fields: dict[str, list[str]] = {}
    for member in c_reference.members():
        struct, *declared = member.split()
        if declared[0].isdigit():
            fields.setdefault(struct, []).append(re.sub(r"\[\w+\]$", "", declared[-1]).lstrip("*"))
    lines = []
    for struct, names in fields.items():
        lines.append(f'  printf("size {struct} %zu\\n", sizeof({struct}));')
        place = f"offsetof({struct}, {{0}}), sizeof((({struct} *)0)->{{0}})"
        lines += [f'  printf("field {struct}.{name} %zu+%zu\\n", {place.format(name)});' for name in names]
    program = "#include <failstop.h>\n#include <stdio.h>\nint main(void) {\n" + "\n".join(lines) + "\n  return 0;\n}\n"
    with tempfile.TemporaryDirectory() as name:
        source, made = Path(name) / "abi.c", Path(name) / "abi"
        source.write_text(program)
        _said("cc", f"-I{SOURCE}/include", "-o", made, source)
        yield from _said(made)


def _said(*words: str | Path) -> list[str]:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.splitlines()


def _built(source: Path, folder: Path) -> Path:
    _said("make", "--silent", "-C", source, f"BUILD={folder}", f"{folder}/{SHARED}")
    return folder


def _beside(ref: str) -> int:
    """What abidiff finds between that commit and this tree."""
    if not shutil.which("abidiff"):
        print("no abidiff: apt install abigail-tools", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory(prefix="failstop-abi-") as name:
        before = Path(name) / "before"
        before.mkdir()
        archive = subprocess.run(
            ("git", "-C", ROOT, "archive", ref, "clients/c", "failstop/version.py"), check=True, capture_output=True
        )
        subprocess.run(("tar", "-x", "-C", before), check=True, input=archive.stdout)
        there = before / "clients" / "c"
        old, new = _built(there, before / "build"), _built(SOURCE, Path(name) / "now")
        headers = ("--headers-dir1", there / "include", "--headers-dir2", SOURCE / "include")
        done = subprocess.run(("abidiff", *headers, old / SHARED, new / SHARED), check=False)
    broke = done.returncode & ~ABIDIFF_CHANGED
    print(f"abidiff: a program of {ref} {'may not run' if broke else 'runs'} with this library")
    return int(broke != 0)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.clients.abi", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the file")
    parser.add_argument("--beside", metavar="REF", help="compare with the library of this commit, by abidiff")
    arguments = parser.parse_args()
    if arguments.beside:
        return _beside(arguments.beside)
    with tempfile.TemporaryDirectory(prefix="failstop-abi-") as name:
        now = described(_built(SOURCE, Path(name)))
    before = RECORDED.read_text() if RECORDED.exists() else ""
    if lost := broken(before, now):
        print("programs that run today would not run:", *lost, sep="\n  ", file=sys.stderr)
        return 1
    if arguments.write:
        RECORDED.write_text(now)
    elif now != before:
        print(f"{RECORDED.name} is not what the library exports; {HOW}", file=sys.stderr)
        return 1
    print(f"{now.count('symbol ')} functions, as {RECORDED.name} records them")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The Python environment of the package as a list of files: this failstop and what it needs, copied from where it runs.

Nothing is downloaded and nothing is built, so what was tried is what is packed. The environment stands by itself but
for the interpreter and its standard library, to which bin/python3 points.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.metadata
import os
import py_compile
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterator
from importlib.metadata import Distribution
from pathlib import Path

import licences

import failstop
import failstop_lab
from failstop.version import VERSION

PREFIX = "/opt/failstop"
"""Where the environment is to be; what the units call is below it."""
PYTHON = f"python{sys.version_info[0]}.{sys.version_info[1]}"
SITE = f"lib/{PYTHON}/site-packages"
LEFT_OUT = frozenset({"__pycache__", "tests", "test", "distutils", "f2py", "include", "_examples"})
"""Folders of the packages that a service has no use for: numpy's tests are a fifth of its size, and what builds
extensions a quarter of its modules."""
LICENCE = Path(__file__).resolve().parents[2] / "LICENSE"
DIST_INFO = ".dist-info"
STUBS = ".pyi"
"""The end of a file's name that type checkers read alone: each file makes an upgrade, and so the service's absence,
longer."""
Find = Callable[[str], Distribution]
EXTRA = re.compile(r"extra == [\"'](\w+)")
"""In a requirement's condition: of which extra it is."""

COMMAND = f"""\
#!{PREFIX}/bin/python3 -I
import sys

from failstop.cli.main import main

sys.exit(main())
"""
CFG = """\
home = /usr/bin
include-system-site-packages = false
version = {version}
"""


class BuildError(Exception):
    """No package is made; the message is one line with the remedy."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One file of the environment, of this text or a copy of `source`, or a link to `target`."""

    path: str
    """Relative to the environment."""
    text: str = ""
    source: str = ""
    target: str = ""
    executable: bool = False


def running(extras: Collection[str] = (), find: Find = importlib.metadata.distribution) -> list[Entry]:
    """The running environment, for the system's interpreter of this version, with what these extras of failstop's need.
    `find`: an installed package by its name. Raises BuildError when it is not whole."""
    entries = [
        Entry("pyvenv.cfg", CFG.format(version=PYTHON.removeprefix("python"))),
        Entry("bin/python3", target=f"/usr/bin/{PYTHON}"),
        Entry("bin/python", target="python3"),
        Entry("bin/failstop", COMMAND, executable=True),
        *_own(),
    ]
    for distribution in needed(extras, find):
        entries += _files(distribution)
    return list({entry.path: entry for entry in entries}.values())


def write(entries: Collection[Entry], directory: Path) -> None:
    """Write them into a new directory, with their modules compiled: the service itself may not write there."""
    for entry in entries:
        path = directory / entry.path
        path.parent.mkdir(parents=True, exist_ok=True)
        if entry.target:
            path.symlink_to(entry.target)
            continue
        path.write_bytes(Path(entry.source).read_bytes() if entry.source else entry.text.encode())
        path.chmod(0o755 if entry.executable else 0o644)
        if path.suffix == ".py":
            # A package may have files for another Python version.
            with warnings.catch_warnings(), contextlib.suppress(py_compile.PyCompileError):
                warnings.simplefilter("ignore")
                _compile(path, f"{PREFIX}/{entry.path}")


def _compile(path: Path, place: str) -> None:
    """Beside the module, by its time: what is compiled by a hash is read twice at each start. The time is that of
    SOURCE_DATE_EPOCH, where it is set: dpkg-deb gives it to the module too."""
    if epoch := os.environ.get("SOURCE_DATE_EPOCH"):
        os.utime(path, (int(epoch), int(epoch)))
    py_compile.compile(str(path), dfile=place, doraise=True, invalidation_mode=py_compile.PycInvalidationMode.TIMESTAMP)


def finder(site: Path) -> Find:
    """Finds failstop where it runs, and every other package below this folder alone."""

    def find(name: str) -> Distribution:
        if name == "failstop":
            return importlib.metadata.distribution(name)
        for found in Distribution.discover(name=name, path=[str(site)]):
            return found
        raise importlib.metadata.PackageNotFoundError(name)

    return find


def needed(extras: Collection[str] = (), find: Find = importlib.metadata.distribution) -> list[Distribution]:
    """Distributions that failstop needs with these extras, directly or not, as far as it is needed on this Python.
    Raises BuildError."""
    found: dict[str, Distribution] = {}
    waiting = ["failstop"]
    while waiting:
        whose = waiting.pop()
        for requirement in _distribution(whose, find).requires or ():
            words, _, marker = requirement.partition(";")
            name = re.split(r"[^A-Za-z0-9._-]", words, maxsplit=1)[0]
            extra = EXTRA.search(marker)
            wanted = extra[1] in extras if extra and whose == "failstop" else "extra" not in marker
            if name in found or not wanted:
                continue
            try:
                found[name] = _distribution(name, find)
            except BuildError:
                # One with a condition is not needed everywhere.
                if extra or not marker:
                    raise
            else:
                waiting.append(name)
    return list(found.values())


def _own() -> Iterator[Entry]:
    """failstop with the rooms that a checkout has next to it, the laboratory, and the metadata that tools look for."""
    for first in (failstop.__file__, failstop_lab.__file__):
        top = os.path.dirname(os.path.abspath(first))
        for folder, folders, names in os.walk(top, followlinks=True):
            folders[:] = sorted(name for name in folders if name != "__pycache__")
            for name in sorted(names):
                source = os.path.join(folder, name)
                yield _copied(os.path.relpath(source, os.path.dirname(top)), source)
    told = f"{SITE}/failstop-{VERSION}.dist-info"
    yield Entry(f"{told}/METADATA", f"Metadata-Version: 2.1\nName: failstop\nVersion: {VERSION}\n")
    yield Entry(f"{told}/INSTALLER", "dpkg\n")
    yield Entry(f"{told}/licenses/LICENSE", LICENCE.read_text())


def _files(distribution: Distribution) -> Iterator[Entry]:
    if not distribution.files:
        raise BuildError(
            f"which files belong to the Python package {distribution.name} is not recorded (it is not pip's): "
            "build with an environment that pip has made"
        )
    texts = 0
    for file in distribution.files:
        source = str(file.locate())
        outside = file.parts[0] == ".." or file.is_absolute()
        licence = file.parts[0].endswith(DIST_INFO) and bool(licences.TEXTS.search(file.parts[-1]))
        wanted = licence or (not LEFT_OUT.intersection(file.parts) and file.suffix != STUBS)
        if not outside and wanted and os.path.isfile(source):
            texts += licence
            yield _copied(str(file), source)
    if not texts:
        name = distribution.name.lower()
        if name not in licences.LACKING:
            raise BuildError(f"{name} {distribution.version} has no text of its licence: give it one in licences.py")
        folder = next(file.parts[0] for file in distribution.files if file.parts[0].endswith(DIST_INFO))
        yield Entry(f"{SITE}/{folder}/licenses/LICENSE", licences.LACKING[name])


def _copied(inside: str, source: str) -> Entry:
    # Wheels have libraries with every mode there is; they are not run.
    executable = os.access(source, os.X_OK) and ".so" not in Path(inside).suffixes
    return Entry(f"{SITE}/{inside}", source=source, executable=executable)


def _distribution(name: str, find: Find) -> Distribution:
    try:
        return find(name)
    except importlib.metadata.PackageNotFoundError:
        raise BuildError(
            f"the Python package {name} is not in the environment that is to be packed ({sys.prefix}): "
            "pip install '.[deb]' there; `make deb` does"
        ) from None

"""The Python environment of the service as a list of files: this failstop and what it needs, copied from where it runs.

Nothing is downloaded and nothing is built, so it works without a network, and what was tried is what is installed. The
environment stands by itself but for the interpreter and its standard library, to which bin/python3 points.
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
from collections.abc import Collection, Iterator
from importlib.metadata import Distribution

import failstop
from failstop.install import InstallError
from failstop.install.system import content
from failstop.version import VERSION

PYTHON = f"python{sys.version_info[0]}.{sys.version_info[1]}"
SITE = f"lib/{PYTHON}/site-packages"
HIDDEN_FROM_SERVICE = ("/root/", "/home/", "/run/user/", "/tmp/", "/var/tmp/")
"""The unit sees none of them (ProtectHome, PrivateTmp)."""
LEFT_OUT = frozenset({"__pycache__", "tests", "distutils", "f2py"})
"""Folders of the packages that a service has no use for: numpy's tests are a fifth of its size, and what builds
extensions a quarter of its modules."""
EXTRA = re.compile(r"extra == [\"'](\w+)")
"""In a requirement's condition: of which extra it is."""

COMMAND = """\
#!{prefix}/bin/python3 -I
import sys

from failstop.cli.main import main

sys.exit(main())
"""
CFG = """\
home = {home}
include-system-site-packages = false
version = {version}
"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One file of the environment, of these bytes or a copy of `source`, or a link to this target."""

    path: str
    """Relative to the environment."""
    content: bytes | str = b""
    source: str = ""
    executable: bool = False

    def read(self) -> bytes | str:
        """A file's bytes, or a link's target."""
        if not self.source:
            return self.content
        with open(self.source, "rb") as file:
            return file.read()


@dataclasses.dataclass(frozen=True)
class Environment:
    """The whole environment: to be at `prefix`, with the interpreter that it is for."""

    prefix: str
    interpreter: str
    entries: tuple[Entry, ...]

    def is_at(self, directory: str, besides: str) -> bool:
        """Whether a directory holds just that, and a file of the name `besides`."""
        found = {os.path.relpath(path, directory) for path in _walk(directory)}
        if found - {besides} != {entry.path for entry in self.entries}:
            return False
        return all(content(os.path.join(directory, entry.path)) == entry.read() for entry in self.entries)

    def write(self, directory: str) -> None:
        """Write all of it into a new directory, with its modules compiled: the service itself may not write there.
        Raises OSError."""
        # Else a strict mask of root's hides it from the service.
        mask = os.umask(0o022)
        try:
            os.mkdir(directory)
            for entry in self.entries:
                path = os.path.join(directory, entry.path)
                if not os.path.isdir(os.path.dirname(path)):
                    os.makedirs(os.path.dirname(path))
                if isinstance(found := entry.read(), str):
                    os.symlink(found, path)
                    continue
                with open(path, "xb") as file:
                    file.write(found)
                    os.fchmod(file.fileno(), 0o755 if entry.executable else 0o644)
            for path in (entry.path for entry in self.entries if entry.path.endswith(".py")):
                # A package may have files for another Python version.
                with warnings.catch_warnings(), contextlib.suppress(py_compile.PyCompileError):
                    warnings.simplefilter("ignore")
                    final = os.path.join(self.prefix, path)
                    py_compile.compile(os.path.join(directory, path), dfile=final, doraise=True)
        finally:
            os.umask(mask)


def _walk(top: str) -> Iterator[str]:
    """The files below a directory but for what was compiled."""
    for folder, folders, names in os.walk(top, followlinks=True):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        yield from (os.path.join(folder, name) for name in sorted(names))


def running(prefix: str, interpreter: str, extras: Collection[str] = ()) -> Environment:
    """The environment that is made from the running one, with what these extras of failstop's need. Raises InstallError
    when that one is not whole."""
    config = CFG.format(home=os.path.dirname(interpreter), version=PYTHON.removeprefix("python"))
    entries = [
        Entry("pyvenv.cfg", config.encode()),
        Entry("bin/python3", interpreter),
        Entry("bin/python", "python3"),
        Entry("bin/failstop", COMMAND.format(prefix=prefix).encode(), executable=True),
        *_own(),
    ]
    for distribution in needed(extras):
        entries += _files(distribution)
    return Environment(prefix, interpreter, tuple({entry.path: entry for entry in entries}.values()))


def _own() -> Iterator[Entry]:
    """This package, with the rooms that a checkout has beside it, and what pip wants to know of it."""
    top = os.path.dirname(os.path.abspath(failstop.__file__))
    for source in _walk(top):
        yield _copied(os.path.relpath(source, os.path.dirname(top)), source)
    # The same text whatever kind of installation it comes from: it counts in the digest.
    needs = sorted(need.replace("'", '"') for need in _distribution("failstop").requires or ())
    lines = ["Metadata-Version: 2.1", "Name: failstop", f"Version: {VERSION}", *(f"Requires-Dist: {n}" for n in needs)]
    texts = {
        "METADATA": "\n".join(lines) + "\n",
        "entry_points.txt": "[console_scripts]\nfailstop = failstop.cli.main:main\n",
        "INSTALLER": "failstop install\n",
    }
    for name, text in texts.items():
        yield Entry(f"{SITE}/failstop-{VERSION}.dist-info/{name}", text.encode())


def _copied(inside: str, source: str) -> Entry:
    return Entry(f"{SITE}/{inside}", source=source, executable=os.access(source, os.X_OK))


def _distribution(name: str, remedy: str = "") -> Distribution:
    try:
        return importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        whole = "install failstop with pip into a virtual environment and call that one's command"
        raise InstallError(
            f"the Python package {name} is not installed where failstop runs ({sys.prefix}): {remedy or whole}"
        ) from None


def needed(extras: Collection[str] = ()) -> list[Distribution]:
    """What failstop needs with these extras, directly or not, as far as it is needed on this Python. Raises
    InstallError."""
    found: dict[str, Distribution] = {}
    waiting = ["failstop"]
    while waiting:
        whose = waiting.pop()
        for requirement in _distribution(whose).requires or ():
            words, _, marker = requirement.partition(";")
            name = re.split(r"[^A-Za-z0-9._-]", words, maxsplit=1)[0]
            extra = EXTRA.search(marker)
            wanted = extra[1] in extras if extra and whose == "failstop" else "extra" not in marker
            if name in found or not wanted:
                continue
            try:
                remedy = f"pip install 'failstop[{extra[1]}]' there, then this again" if extra else ""
                found[name] = _distribution(name, remedy)
            except InstallError:
                # One with a condition is not needed everywhere.
                if extra or not marker:
                    raise
            else:
                waiting.append(name)
    return list(found.values())


def _files(distribution: Distribution) -> Iterator[Entry]:
    if not distribution.files:
        raise InstallError(
            f"which files belong to the Python package {distribution.name} is not recorded (it is not pip's): "
            "install failstop with pip into a virtual environment and call that one's command"
        )
    for file in distribution.files:
        source = str(file.locate())
        outside = file.parts[0] == ".." or file.is_absolute()
        if not outside and not LEFT_OUT.intersection(file.parts) and os.path.isfile(source):
            yield _copied(str(file), source)


def interpreter() -> str:
    """The interpreter for the environment: the one that runs, or the system's of the same version when the service
    could not reach that one. Raises InstallError when there is neither."""
    base: str = getattr(sys, "_base_executable", sys.executable)
    own, systems = os.path.realpath(base), f"/usr/bin/{PYTHON}"
    if not (problem := unreachable(own)):
        # The name that stays when the distribution updates the interpreter.
        return systems if os.path.realpath(systems) == own else own
    if unreachable(systems):
        raise InstallError(
            f"the service could not run {own}: {problem}. Install {PYTHON} as a package of the system, "
            "or install failstop with a Python outside of home directories"
        )
    return systems


def unreachable(path: str) -> str:
    """Why the service could not run this file, as far as can be seen before it is tried; empty: it can."""
    if path.startswith(HIDDEN_FROM_SERVICE):
        return f"{path.split('/')[1]} is hidden from it"
    return "" if os.access(path, os.X_OK) else "it is not there, or can't be run"

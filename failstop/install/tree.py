"""The Python environment of the service as a list of files: this failstop and what it needs, copied from where it runs.

Nothing is downloaded and nothing is built, so it works without a network, and what was tried is what is installed. The
environment stands by itself but for the interpreter and its standard library, to which bin/python3 points.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import os
import py_compile
import re
import stat
import struct
import sys
import warnings
from collections.abc import Collection, Iterator
from importlib.metadata import Distribution
from importlib.util import MAGIC_NUMBER, cache_from_source

import failstop
from failstop.install import InstallError
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
_HEAD = struct.Struct("<4sLLL")
"""Of a compiled module that knows its source by time and size: its Python, 0, the source's time, its size."""

COMMAND = """\
#!{prefix}/bin/python3 -I
import sys

from failstop.cli.main import main

sys.exit(main())
"""
METADATA = "Metadata-Version: 2.1\nName: failstop\nVersion: {version}\n"
CFG = """\
home = {home}
include-system-site-packages = false
version = {version}
"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One file of the environment: a copy of `source`, or these bytes, or a link to a target."""

    path: str
    """Relative to the environment."""
    source: str = ""
    data: bytes = b""
    target: str = ""
    executable: bool = False

    def read(self) -> bytes:
        """What the file holds."""
        if self.source:
            with open(self.source, "rb") as file:
                return file.read()
        return self.data


@dataclasses.dataclass(frozen=True)
class Environment:
    """The whole environment: to be at `prefix`, with the interpreter that it is for."""

    prefix: str
    interpreter: str
    entries: tuple[Entry, ...]

    def digest(self) -> str:
        """What identifies its content."""
        return _digest(
            (entry.path, b"-> " + entry.target.encode() if entry.target else entry.read()) for entry in self.entries
        )

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
                if entry.target:
                    os.symlink(entry.target, path)
                else:
                    with open(path, "xb") as file:
                        file.write(entry.read())
                        os.fchmod(file.fileno(), 0o755 if entry.executable else 0o644)
            for entry in self.entries:
                if entry.path.endswith(".py"):
                    self._compile(entry, os.path.join(directory, entry.path))
        finally:
            os.umask(mask)

    def _compile(self, entry: Entry, path: str) -> None:
        if not _copy_compiled(entry.source, path):
            # A package may have files for another Python version.
            with warnings.catch_warnings(), contextlib.suppress(py_compile.PyCompileError):
                warnings.simplefilter("ignore")
                py_compile.compile(path, dfile=os.path.join(self.prefix, entry.path), doraise=True)


def _copy_compiled(source: str, path: str) -> bool:
    """Put the compiled module that lies beside the source, if it is of that very source, beside its copy, which gets
    the source's time for it; True when done. The import mends the path in it."""
    try:
        with open(cache_from_source(source), "rb") as file:
            compiled = file.read()
        found = os.stat(source)
        if compiled[:16] != _HEAD.pack(MAGIC_NUMBER, 0, int(found.st_mtime) & 0xFFFFFFFF, found.st_size & 0xFFFFFFFF):
            return False
        os.utime(path, ns=(found.st_atime_ns, found.st_mtime_ns))
        beside = cache_from_source(path)
        os.makedirs(os.path.dirname(beside), exist_ok=True)
        with open(beside, "xb") as file:
            file.write(compiled)
    except OSError:
        return False
    return True


def _digest(files: Iterator[tuple[str, bytes]]) -> str:
    whole = hashlib.sha256()
    for path, data in sorted(files):
        whole.update(path.encode() + b"\0" + hashlib.sha256(data).digest())
    return whole.hexdigest()


def digest_of(directory: str, without: str) -> str:
    """The same digest of an environment that is on disk; `without` names a file at its top that is not part of it."""
    return _digest(_on_disk(directory, without))


def _on_disk(directory: str, without: str) -> Iterator[tuple[str, bytes]]:
    for folder, folders, names in os.walk(directory):
        folders[:] = [name for name in folders if name != "__pycache__"]
        for name in names:
            path = os.path.join(folder, name)
            inside = os.path.relpath(path, directory)
            if os.path.islink(path):
                yield inside, b"-> " + os.readlink(path).encode()
            elif inside != without:
                with open(path, "rb") as file:
                    yield inside, file.read()


def running(prefix: str, interpreter: str, extras: Collection[str] = ()) -> Environment:
    """The environment that is made from the running one, with what these extras of failstop's need. Raises InstallError
    when that one is not whole."""
    home = os.path.dirname(interpreter)
    entries = [
        Entry("pyvenv.cfg", data=CFG.format(home=home, version=PYTHON.removeprefix("python")).encode()),
        Entry("bin/python3", target=interpreter),
        Entry("bin/python", target="python3"),
        Entry("bin/failstop", data=COMMAND.format(prefix=prefix).encode(), executable=True),
        *_own(),
    ]
    for distribution in needed(extras):
        entries += _files(distribution)
    return Environment(prefix, interpreter, tuple({entry.path: entry for entry in entries}.values()))


def _own() -> Iterator[Entry]:
    """This package, with the rooms that a checkout has beside it, and what pip wants to know of it."""
    top = os.path.dirname(os.path.abspath(failstop.__file__))
    for folder, folders, names in os.walk(top, followlinks=True):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        for name in sorted(names):
            source = os.path.join(folder, name)
            inside = os.path.relpath(source, os.path.dirname(top))
            yield Entry(f"{SITE}/{inside}", source, executable=os.access(source, os.X_OK))
    info = f"{SITE}/failstop-{VERSION}.dist-info"
    # The same text whatever kind of installation it comes from: it counts in the digest.
    needs = sorted(need.replace("'", '"') for need in _distribution("failstop").requires or ())
    text = METADATA.format(version=VERSION) + "".join(f"Requires-Dist: {need}\n" for need in needs)
    yield Entry(f"{info}/METADATA", data=text.encode())
    yield Entry(f"{info}/entry_points.txt", data=b"[console_scripts]\nfailstop = failstop.cli.main:main\n")
    yield Entry(f"{info}/INSTALLER", data=b"failstop install\n")


def _distribution(name: str) -> Distribution:
    try:
        return importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        raise InstallError(
            f"the Python package {name} is not installed where failstop runs ({sys.prefix}): "
            "install failstop with pip into a virtual environment and call that one's command"
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
            match = re.match(r"[A-Za-z0-9._-]+", words)
            extra = EXTRA.search(marker)
            wanted = extra[1] in extras if extra and whose == "failstop" else "extra" not in marker
            if match is None or match[0] in found or not wanted:
                continue
            try:
                found[match[0]] = _distribution(match[0])
            except InstallError:
                if extra:
                    raise InstallError(
                        f"the Python package {match[0]} is not installed where failstop runs ({sys.prefix}): "
                        f"pip install 'failstop[{extra[1]}]' there, then this again"
                    ) from None
                # One with a condition is not needed everywhere.
                if not marker:
                    raise
            else:
                waiting.append(match[0])
    return list(found.values())


def _files(distribution: Distribution) -> Iterator[Entry]:
    files = distribution.files
    if not files:
        raise InstallError(
            f"which files belong to the Python package {distribution.name} is not recorded (it is not pip's): "
            "install failstop with pip into a virtual environment and call that one's command"
        )
    for file in files:
        if file.parts[0] == ".." or file.is_absolute() or LEFT_OUT.intersection(file.parts):
            continue
        source = str(file.locate())
        if os.path.isfile(source):
            yield Entry(f"{SITE}/{file}", source, executable=os.access(source, os.X_OK))


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
    """Why the service's user could not run or read this file; empty: it can."""
    if path.startswith(HIDDEN_FROM_SERVICE):
        return f"{path.split('/')[1]} is hidden from it"
    part = path
    try:
        if not os.stat(path).st_mode & stat.S_IXOTH:
            return "others may not execute it"
        while part != "/":
            part = os.path.dirname(part)
            if not os.stat(part).st_mode & stat.S_IXOTH:
                return f"others may not enter {part}"
    except OSError as error:
        return error.strerror.lower() if error.strerror else str(error)
    return ""

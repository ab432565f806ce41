"""The Python environment of the package as a list of files: this failstop and what it needs, copied from where it is
installed.

The environment needs nothing of the system but its Python 3 and the standard library, to which bin/python3 points. Its
packages lie in one folder for every Python: compiled modules of several versions have different names, so they can lie
next to each other.
"""

from __future__ import annotations

import dataclasses
import gzip
import importlib.metadata
import io
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from importlib.metadata import Distribution
from pathlib import Path

import licences

import failstop
import failstop_lab
from failstop.version import VERSION

PREFIX = "/opt/failstop"
"""Where the environment is to be; what the units call is below it."""
VERSION_HERE = f"{sys.version_info[0]}.{sys.version_info[1]}"
"""The version of the Python that runs this."""
SITE = "site-packages"
"""The folder of the packages, in the environment."""
COMPILED = "compiled"
"""The folder of the compiled copies, in the environment: an archive for each Python, which the installation unpacks."""
LEFT_OUT = frozenset({"__pycache__", "tests", "test", "distutils", "f2py", "include", "_examples"})
"""Folders of the packages that a service has no use for."""
NOT_PACKED = frozenset({"numpy"})
"""Distributions that failstop needs only for plots, which the package can't draw because it has no matplotlib."""
OF_THE_WHEEL = ("WHEEL", "RECORD", "INSTALLER", "REQUESTED", "direct_url.json")
"""Files in a .dist-info directory that say how a wheel was built or installed, and so differ from Python to Python."""
LICENCE = Path(__file__).resolve().parents[2] / "LICENSE"
DIST_INFO = ".dist-info"
STUBS = ".pyi"
"""The end of a file's name that type checkers read alone: each file makes an upgrade, and so the service's absence,
longer."""
Find = Callable[[str], Distribution]
EXTRA = re.compile(r"extra == [\"'](\w+)")
"""In a requirement's condition: of which extra it is."""

COMMAND = f"""\
#!{PREFIX}/bin/python3 -IB
import sys

from failstop.cli.main import main

sys.exit(main())
"""
CFG = """\
home = /usr/bin
include-system-site-packages = false
"""
PTH = f"{PREFIX}/{SITE}\n"
COMPILE = """\
import os, py_compile, sys, warnings
warnings.simplefilter("ignore")
top, out, place = sys.argv[1:]
for folder, folders, names in os.walk(top):
    folders.sort()
    for name in sorted(name for name in names if name.endswith(".py")):
        path = os.path.join(folder, name)
        inside = os.path.relpath(path, top)
        cached = f"{name[:-2]}{sys.implementation.cache_tag}.pyc"
        cached = os.path.join(out, os.path.dirname(inside), "__pycache__", cached)
        try:
            py_compile.compile(
                path, cached, os.path.join(place, inside), doraise=True,
                invalidation_mode=py_compile.PycInvalidationMode.TIMESTAMP,
            )
        except py_compile.PyCompileError:
            pass  # a package may have files for another Python
"""
"""A program for the interpreter to compile for. By the module's time: what is compiled by a hash is read twice at each
start."""


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


def here() -> dict[str, Find]:
    """The packages of the running environment, for its Python."""
    return {VERSION_HERE: importlib.metadata.distribution}


def running(extras: Collection[str] = (), finds: Mapping[str, Find] | None = None) -> list[Entry]:
    """The running failstop with its needs and those of these extras. `finds`: by the version of a Python, what finds an
    installed package for it (default: here()). Raises BuildError when it is not whole."""
    finds = finds or here()
    entries = [
        Entry("pyvenv.cfg", CFG),
        Entry("bin/python3", target="/usr/bin/python3"),
        Entry("bin/python", target="python3"),
        Entry("bin/failstop", COMMAND, executable=True),
        *(Entry(f"lib/python{python}/site-packages/failstop.pth", PTH) for python in finds),
        *_own(),
    ]
    found: dict[str, Entry] = {entry.path: entry for entry in entries}
    for python, find in finds.items():
        for distribution in needed(extras, find):
            for entry in _files(distribution):
                if _content(found.setdefault(entry.path, entry)) != _content(entry):
                    raise BuildError(
                        f"{entry.path} is not the same for Python {python} as for {next(iter(finds))}: "
                        f"take the same version of {distribution.name} for each"
                    )
    return list(found.values())


def _content(entry: Entry) -> bytes:
    return Path(entry.source).read_bytes() if entry.source else entry.text.encode()


def write(entries: Collection[Entry], directory: Path) -> None:
    """Write them into a new directory. The modules' time is that of SOURCE_DATE_EPOCH, where it is set: dpkg-deb packs
    them with it, and the compiled copies name it."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    for entry in entries:
        path = directory / entry.path
        path.parent.mkdir(parents=True, exist_ok=True)
        if entry.target:
            path.symlink_to(entry.target)
            continue
        path.write_bytes(_content(entry))
        path.chmod(0o755 if entry.executable else 0o644)
        if epoch:
            os.utime(path, (int(epoch), int(epoch)))


def compiled(directory: Path, interpreter: str) -> bytes:
    """An archive of the modules in a written environment, compiled by this interpreter: they are unpacked there.
    Raises BuildError."""
    with tempfile.TemporaryDirectory(prefix="failstop-compiled-") as out:
        # Not -I, which draws a hash seed of its own: until Python 3.11 a compiled set has the order of its hashes.
        words = (interpreter, "-s", "-S", "-c", COMPILE, str(directory / SITE), out, f"{PREFIX}/{SITE}")
        environ = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
        environ["PYTHONHASHSEED"] = "0"
        done = subprocess.run(words, env=environ, cwd=out, capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"{interpreter} can't compile the modules: {done.stderr.strip()}")
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as archive:
            for path in sorted(Path(out).rglob("*.pyc")):
                row = tarfile.TarInfo(f"{SITE}/{path.relative_to(out)}")
                row.mode, row.size = 0o644, path.stat().st_size
                row.mtime = int(os.environ.get("SOURCE_DATE_EPOCH", 0))
                archive.addfile(row, io.BytesIO(path.read_bytes()))
    return gzip.compress(packed.getvalue(), 9, mtime=0)


def finder(site: Path) -> Find:
    """Finds failstop where it runs, and every other package below this folder alone."""

    def find(name: str) -> Distribution:
        if name == "failstop":
            return importlib.metadata.distribution(name)
        for found in Distribution.discover(name=name, path=[str(site)]):
            return found
        raise importlib.metadata.PackageNotFoundError(name)

    return find


def needed(
    extras: Collection[str] = (),
    find: Find = importlib.metadata.distribution,
    without: Collection[str] = NOT_PACKED,
) -> list[Distribution]:
    """Distributions that failstop needs with these extras on a Python, directly or not, `without` those that the
    package does not carry. Raises BuildError."""
    found: dict[str, Distribution] = {}
    waiting = ["failstop"]
    while waiting:
        whose = waiting.pop()
        for requirement in _distribution(whose, find).requires or ():
            words, _, marker = requirement.partition(";")
            name = re.split(r"[^A-Za-z0-9._-]", words, maxsplit=1)[0]
            extra = EXTRA.search(marker)
            wanted = extra[1] in extras if extra and whose == "failstop" else "extra" not in marker
            if name in found or not wanted or name in without:
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
        about = file.parts[0].endswith(DIST_INFO) and file.parts[-1] in OF_THE_WHEEL
        wanted = licence or (not LEFT_OUT.intersection(file.parts) and file.suffix != STUBS and not about)
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

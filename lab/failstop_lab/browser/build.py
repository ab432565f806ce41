"""Build: the page as one file that needs no network: Python for the browser, failstop's modules and the page's own.

`python -m failstop_lab.browser.build PYODIDE FILE`; `make browser` installs the first from the npm registry.
"""

from __future__ import annotations

import base64
import gzip
import importlib
import io
import json
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import msgpack

import failstop
import failstop_lab

PACKAGE = Path(failstop.__file__).parent
PAGE = Path(__file__).parent / "page"
STYLES = [PACKAGE / "web" / "page" / name for name in ("stop.css", "page.css")]
"""The operator's page's."""
NOT_NEEDED = (
    *("failstop/fleet", "failstop/ros2"),
    *(f"failstop_lab/{room}" for room in ("case", "commands", "faults", "pages", "prove", "simulate")),
)
"""Folders that nothing on the page asks for."""
LINUX = ("_socket", "fcntl", "mmap", "os", "resource", "select", "signal", "socket", "termios", "time")
"""Modules whose numbers the simulated machine takes from Python's own."""
UNUSED = ("pydoc_data/", "unittest/", "idlelib/", "tkinter/", "ensurepip/", "sqlite3/", "xmlrpc/", "lib2to3/", "turtle")
"""Parts of Python's library that nothing on the page asks for."""


def numbers() -> str:
    """The module `linux`: what Linux's modules have in numbers, for those that are not, or not whole, in a browser."""
    found = {name: importlib.import_module(name) for name in LINUX}
    values = {name: {k: int(v) for k, v in vars(found[name]).items() if isinstance(v, int)} for name in LINUX}
    return f"VALUES = {values!r}\n"


def modules() -> Iterator[tuple[Path, str]]:
    """(file, name in the archive) of each module that the page imports from."""
    for package in (PACKAGE, Path(failstop_lab.__file__).parent):
        for path in sorted(package.glob("**/*.py")):
            name = path.relative_to(package.parent).as_posix()
            if not name.startswith(NOT_NEEDED):
                yield path, name
    for room in ("procs", "shm", "supervisor"):  # links, which glob does not follow everywhere
        for path in sorted((PACKAGE / room).glob("**/*.py")):
            yield path, f"failstop/{room}/{path.relative_to(PACKAGE / room).as_posix()}"
    for path in sorted(Path(msgpack.__file__).parent.glob("*.py")):
        yield path, f"msgpack/{path.name}"
    yield Path(__file__).parent / "stacks.py", "greenlet.py"
    yield Path(__file__).parent / "start.py", "start.py"


def archive() -> bytes:
    """The modules, as a zip that is equal for equal modules."""
    files = {name: path.read_bytes() for path, name in modules()}
    return zipped({**files, "linux.py": numbers().encode()})


def zipped(files: dict[str, bytes]) -> bytes:
    """A zip without times, not compressed: the page's packing does that."""
    into = io.BytesIO()
    with zipfile.ZipFile(into, "w") as made:
        for name, data in files.items():
            made.writestr(zipfile.ZipInfo(name), data)
    return into.getvalue()


def library(path: Path) -> bytes:
    """Python's library, without what is not used."""
    with zipfile.ZipFile(path) as found:
        return zipped({name: found.read(name) for name in found.namelist() if not name.startswith(UNUSED)})


def packed(data: bytes) -> str:
    """Bytes as the page unpacks them."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


def page(pyodide: Path) -> str:
    """The whole page."""
    parts = {
        "style": "".join(path.read_text() for path in (*STYLES, PAGE / "robot.css")),
        "wasm": packed((pyodide / "pyodide.asm.wasm").read_bytes()),
        "library": packed(library(pyodide / "python_stdlib.zip")),
        "modules": packed(archive()),
        "machine": packed((pyodide / "pyodide.asm.js").read_bytes()),
        "pyodide": packed((pyodide / "pyodide.js").read_bytes()),
        "lock": json.dumps({"info": json.loads((pyodide / "pyodide-lock.json").read_text())["info"], "packages": {}}),
        "script": (PAGE / "robot.js").read_text(),
    }
    text = (PAGE / "robot.html").read_text()
    for name, part in parts.items():
        text = text.replace(f"/*{name}*/", part)
    return text


def main(pyodide: str, file: str) -> None:
    """Write the page."""
    text = page(Path(pyodide))
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_text(text)
    print(f"{file}: {len(text) / 1e6:.1f} MB")


if __name__ == "__main__":
    main(*sys.argv[1:])

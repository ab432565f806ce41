"""Tests that start a process: `make quick` runs the others, and none of those may.

A file starts processes when it, or a helper that it imports from the tests, or what its conftest.py imports for the
fixtures that it uses, imports one of STARTERS or calls one of CALLS. That is read from the source, so that what is not
wanted is not even imported. A single test that starts one though its file does not look like it is marked `starts`.

What a file says is kept in `.pytest_cache` until the file changes: else each worker would parse all files of the tests.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import os
import pickle
from pathlib import Path

ROOT = Path(__file__).parents[2]
KEPT = ROOT / ".pytest_cache" / "sources"
STARTERS = frozenset(
    {
        *("multiprocessing", "subprocess"),
        *("failstop_lab.faults.arm", "failstop_lab.faults.crowd", "failstop_lab.faults.scene"),
        *("failstop_lab.sim.client", "failstop.supervisor.starter", "failstop_lab.trial"),
    }
)
"""Modules that are there to start processes."""
TOPS = ("tests", "bench")
"""Folders whose files are read."""
CALLS = frozenset({"fork", "forkpty", "popen", "posix_spawn", "posix_spawnp", "spawnv", "system"})
"""Functions of os and pty that start a process."""
EVENTS = frozenset({"os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system", "subprocess.Popen"})
"""Audit events of the interpreter when a process is started."""


@dataclasses.dataclass(frozen=True)
class Source:
    """The source of a file of tests or helpers, as far as it starts processes."""

    imports: dict[str, set[str]]
    """Whole names that a name in it stands for, of modules or of what it takes from one."""
    functions: dict[str, set[str]]
    """The functions of a conftest.py, its fixtures among them: the names that each uses."""
    calls: bool
    names: set[str]
    """All arguments and texts: a test asks for a fixture by either."""


def starts(path: Path) -> bool:
    left = [path]
    seen = set(left)
    while left:
        file = left.pop()
        source = read(file)
        modules = set().union(*source.imports.values()) | _fixtures(file.with_name("conftest.py"), source.names)
        if source.calls or modules & STARTERS:
            return True
        helpers = {helper for module in modules for helper in _files(module)} - seen
        left += helpers
        seen |= helpers
    return False


def _fixtures(conftest: Path, asked: set[str]) -> set[str]:
    """Imports of a conftest.py for the fixtures that are asked for, and for those that these ask for."""
    if not conftest.exists():
        return set()
    source = read(conftest)
    used: set[str] = set()
    left = asked & set(source.functions)
    while left:
        used |= left
        left = set().union(*(source.functions[name] for name in left & set(source.functions))) - used
    return {module for name in used for module in source.imports.get(name, ())}


Stamp = tuple[int, int, int]
"""When a file and this module were changed, and how long the file is."""


def _stamp(path: Path) -> Stamp:
    status = path.stat()
    return status.st_mtime_ns, status.st_size, Path(__file__).stat().st_mtime_ns


@functools.cache
def _kept() -> dict[str, tuple[Stamp, Source]]:
    with contextlib.suppress(Exception):  # whatever is in that file: it is made again
        found: dict[str, tuple[Stamp, Source]] = pickle.loads(KEPT.read_bytes())
        return found
    return {}


_new: list[str] = []
"""Files that this process has parsed."""


def keep() -> None:
    """Write down what this process has parsed, for the next ones."""
    if _new:
        KEPT.parent.mkdir(exist_ok=True)
        draft = KEPT.with_name(f"{KEPT.name}.{os.getpid()}")
        draft.write_bytes(pickle.dumps(_kept()))
        draft.replace(KEPT)
        _new.clear()


@functools.cache
def read(path: Path) -> Source:
    stamp, (known, source) = _stamp(path), _kept().get(str(path), (None, None))
    if source is None or known != stamp:
        source = _parsed(path)
        _kept()[str(path)] = stamp, source
        _new.append(str(path))
    return source


def _parsed(path: Path) -> Source:
    tree = ast.parse(path.read_text("utf-8"))
    top = max(at for at, part in enumerate(path.parts) if part in TOPS)
    imports: dict[str, set[str]] = {}
    names: set[str] = set()
    calls = False
    for node in nodes(tree):
        match node:
            case ast.Import():
                for alias in node.names:
                    imports.setdefault(alias.asname or alias.name.partition(".")[0], set()).add(alias.name)
            case ast.ImportFrom():
                package = ".".join(path.parts[top : -node.level]) if node.level else ""
                module = ".".join(part for part in (package, node.module) if part)
                for alias in node.names:
                    imports.setdefault(alias.asname or alias.name, set()).update((module, f"{module}.{alias.name}"))
            case ast.Attribute(value=ast.Name(id="os" | "pty")):
                calls |= node.attr in CALLS
            case ast.arg():
                names.add(node.arg)
            case ast.Constant(value=str() as text):
                names.add(text)
    functions = {}
    if path.name == "conftest.py":
        functions = {node.name: _used(node) for node in tree.body if isinstance(node, ast.FunctionDef)}
    return Source(imports, functions, calls, names)


def nodes(tree: ast.AST) -> list[ast.AST]:
    """All nodes, each before those within it, in half the time of ast.walk()."""
    found = [tree]
    for node in found:
        for name in node._fields:
            value = getattr(node, name, None)
            if isinstance(value, list):
                found += [each for each in value if isinstance(each, ast.AST)]
            elif isinstance(value, ast.AST) and value._fields:
                found.append(value)
    return found


def _used(function: ast.FunctionDef) -> set[str]:
    nodes = list(ast.walk(function))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.arg for node in nodes if isinstance(node, ast.arg)}


@functools.cache
def _files(module: str) -> list[Path]:
    """The files of a module of the tests or of the bench; of any other, none."""
    if module.partition(".")[0] not in TOPS:
        return []
    place = ROOT.joinpath(*module.split("."))
    return [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.exists()]

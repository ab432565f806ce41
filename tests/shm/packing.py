"""A reading of source text for stores into shared memory: packing in place, raw copies, foreign byte orders.

It sees what is written in the source and not what a name turns out to be at run time; the names it looks for are such
that nothing else in this project should have them.
"""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterator
from typing import NamedTuple

from tests.support.starting import nodes

ROOMS = ("shm", "supervisor", "procs", "failstop")

FORBIDDEN = frozenset(
    {"pack_into", "memmove", "memset", "from_buffer", "from_address", "write_byte", "string_at", "copyto", "putmask"}
)
"""Stores in place: struct's zero-fills first, the rest go past the one slice assignment."""

STRUCT_CALLS = frozenset({"Struct", "pack", "unpack", "unpack_from", "iter_unpack", "calcsize", "pack_into"})
SHARED = frozenset({"_view", "view", "mapped", "_mapped", "_cells"})
"""Attributes under which this project keeps shared memory."""


MAY_HAVE_ONE = re.compile(rf"\b({'|'.join(FORBIDDEN | STRUCT_CALLS | SHARED)}|memoryview)\b")
"""Found in the text of every file with a violation, so that the others need no parsing."""


class Finding(NamedTuple):
    """One violation: where, and what."""

    path: str
    line: int
    what: str


def sources(root: str) -> Iterator[str]:
    """Every Python file of the rooms, by its path from the root; links to rooms are not followed twice.

    Not the simulated board, which shares no memory.
    """
    for room in ROOMS:
        for base, directories, files in os.walk(os.path.join(root, room)):
            directories[:] = [
                d for d in directories if not os.path.islink(os.path.join(base, d)) and d != "__pycache__"
            ]
            for file in sorted(files):
                path = os.path.relpath(os.path.join(base, file), root)
                if file.endswith(".py") and not path.startswith("failstop/lab/sim/"):
                    yield path


def _leading_text(node: ast.AST, constants: dict[str, str]) -> str:
    """The begin of a format expression, as far as the source says."""
    match node:
        case ast.Constant(value=bytes(value)):
            return value.decode("latin-1")
        case ast.Constant(value=str(value)):
            return value
        case ast.JoinedStr(values=[first, *_]) | ast.BinOp(left=first) | ast.FormattedValue(value=first):
            return _leading_text(first, constants)
    return constants.get(_name(node), "")


def _name(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _makes_view(node: ast.AST) -> bool:
    """memoryview(...), and what .cast or a slice makes of it."""
    if isinstance(node, ast.Call):
        cast = isinstance(node.func, ast.Attribute) and node.func.attr == "cast" and _makes_view(node.func.value)
        return cast or _name(node.func) == "memoryview"
    return isinstance(node, ast.Subscript) and _makes_view(node.value)


def _targets(node: ast.AST) -> list[ast.expr]:
    """The targets of an assignment, one by one."""
    if isinstance(node, ast.AnnAssign | ast.NamedExpr | ast.AugAssign):
        return [node.target]
    targets = node.targets if isinstance(node, ast.Assign | ast.Delete) else []
    return [part for each in targets for part in (each.elts if isinstance(each, ast.Tuple | ast.List) else [each])]


def read(path: str, text: str) -> list[Finding]:
    """Every violation in one file's text."""
    if not MAY_HAVE_ONE.search(text):
        return []
    found = nodes(ast.parse(text, path))
    constants: dict[str, str] = {}
    views: set[str] = set()
    for node in found:
        value = getattr(node, "value", None)
        for target in _targets(node):
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                constants[_name(target)] = value.value
            if value is not None and _makes_view(value):
                views.add(_name(target))
    return [
        Finding(path, getattr(node, "lineno", 0), what) for node in found for what in _wrong(node, constants, views)
    ]


def _wrong(node: ast.AST, constants: dict[str, str], views: set[str]) -> Iterator[str]:
    said = [_name(node), *([alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else [])]
    if isinstance(node, ast.Constant):  # getattr(struct, "pack_into")
        said.append(str(node.value))
    yield from FORBIDDEN & set(said)
    if isinstance(node, ast.Call) and _name(node.func) in STRUCT_CALLS:
        for form in node.args[:1] + [word.value for word in node.keywords if word.arg == "format"]:
            if _leading_text(form, constants).lstrip()[:1] in (">", "!"):
                yield "big-endian format"
    for part in _targets(node):
        if not isinstance(part, ast.Subscript):
            continue
        if _name(part.value) in views or _makes_view(part.value):
            yield "store through a memoryview"
        elif _name(part.value) in SHARED and not (isinstance(node, ast.Assign) and isinstance(part.slice, ast.Slice)):
            yield "store into shared memory that is not one slice assignment"
    if isinstance(node, ast.FunctionDef):
        stores = [each for each in nodes(node) if isinstance(each, ast.Subscript) and isinstance(each.ctx, ast.Store)]
        for _ in [each for each in stores if _name(each.value) in SHARED][1:]:
            yield "a second store into shared memory in one function"

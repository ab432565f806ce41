"""A reading of source text for stores into shared memory: packing in place, raw copies, foreign byte orders.

It sees what is written in the source and not what a name turns out to be at run time; the names it looks for are such
that nothing else in this project should have them.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator

ROOMS = ("shm", "board", "policy", "supervisor", "procs", "failstop")

FORBIDDEN = frozenset(
    {"pack_into", "memmove", "memset", "from_buffer", "from_address", "write_byte", "string_at", "copyto", "putmask"}
)
"""Stores in place: struct's zero-fills first, the rest go past the one slice assignment."""

STRUCT_CALLS = frozenset({"Struct", "pack", "unpack", "unpack_from", "iter_unpack", "calcsize", "pack_into"})
SHARED = frozenset({"_view", "view", "mapped", "_mapped", "_cells"})
"""Attributes under which this project keeps shared memory."""


class Finding:
    """One violation: where, and what."""

    def __init__(self, path: str, line: int, what: str) -> None:
        self.path = path
        self.line = line
        self.what = what

    def __repr__(self) -> str:
        return f"{self.path}:{self.line}: {self.what}"


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
    """What a format expression starts with, as far as the source says."""
    if isinstance(node, ast.Constant):
        value = node.value
        return value.decode("latin-1") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    if isinstance(node, ast.JoinedStr) and node.values:
        return _leading_text(node.values[0], constants)
    if isinstance(node, ast.BinOp):
        return _leading_text(node.left, constants)
    if isinstance(node, ast.FormattedValue):
        return _leading_text(node.value, constants)
    if isinstance(node, ast.Name):
        return constants.get(node.id, "")
    if isinstance(node, ast.Attribute):
        return constants.get(node.attr, "")
    return ""


def _name(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


class _Reader(ast.NodeVisitor):
    def __init__(self, path: str, tree: ast.AST) -> None:
        self.path = path
        self.found: list[Finding] = []
        self.constants: dict[str, str] = {}
        self.views: set[str] = set()
        for node in ast.walk(tree):
            targets = node.targets if isinstance(node, ast.Assign) else []
            if isinstance(node, ast.AnnAssign | ast.NamedExpr):
                targets = [node.target]
            value = getattr(node, "value", None)
            for target in targets:
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    self.constants[_name(target)] = value.value
                if value is not None and _makes_view(value):
                    self.views.add(_name(target))

    def note(self, node: ast.AST, what: str) -> None:
        self.found.append(Finding(self.path, getattr(node, "lineno", 0), what))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if node.attr in FORBIDDEN:
            self.note(node, node.attr)
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in FORBIDDEN:
            self.note(node, node.id)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        for alias in node.names:
            if alias.name in FORBIDDEN:
                self.note(node, alias.name)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and node.value in FORBIDDEN:  # getattr(struct, "pack_into")
            self.note(node, node.value)

    def visit_Call(self, node: ast.Call) -> None:
        if _name(node.func) in STRUCT_CALLS:
            given = node.args[:1] + [word.value for word in node.keywords if word.arg == "format"]
            for form in given:
                if _leading_text(form, self.constants).lstrip()[:1] in (">", "!"):
                    self.note(node, "big-endian format")
        self.generic_visit(node)

    def _store(self, target: ast.expr, *, in_place: bool) -> None:
        for part in target.elts if isinstance(target, ast.Tuple | ast.List) else [target]:
            if not isinstance(part, ast.Subscript):
                continue
            name = _name(part.value)
            if name in self.views or _makes_view(part.value):
                self.note(part, "store through a memoryview")
            elif name in SHARED and (in_place or not isinstance(part.slice, ast.Slice)):
                self.note(part, "store into shared memory that is not one slice assignment")

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._store(target, in_place=False)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._store(node.target, in_place=True)
        self.generic_visit(node)

    def visit_Delete(self, node: ast.Delete) -> None:
        for target in node.targets:
            self._store(target, in_place=True)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        stores = [
            part
            for part in ast.walk(node)
            if isinstance(part, ast.Subscript) and isinstance(part.ctx, ast.Store) and _name(part.value) in SHARED
        ]
        for extra in stores[1:]:
            self.note(extra, "a second store into shared memory in one function")
        self.generic_visit(node)


def _makes_view(node: ast.AST) -> bool:
    """memoryview(...), and what .cast or a slice makes of it."""
    if isinstance(node, ast.Call):
        if _name(node.func) == "memoryview":
            return True
        return isinstance(node.func, ast.Attribute) and node.func.attr == "cast" and _makes_view(node.func.value)
    return isinstance(node, ast.Subscript) and _makes_view(node.value)


def read(path: str, text: str) -> list[Finding]:
    """Every violation in one file's text."""
    tree = ast.parse(text, path)
    reader = _Reader(path, tree)
    reader.visit(tree)
    return reader.found

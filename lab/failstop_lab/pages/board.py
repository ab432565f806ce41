"""The page docs/reference/board.md: what describes a board, and what failstop uses of it, from the docstrings."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator

from failstop_lab.pages.reference import fields, flat, members, table
from failstop_lab.pages.rooms import PACKAGE

PAGE_HEAD = """# A board: reference

On this page you can look up every field of a board's description. [Porting](../porting.md) shows how to write one.
Times whose name ends with `_ns` are in nanoseconds, and speeds whose name ends with `_rps` in turns per second.
Generated from the docstrings of `failstop/board` (`make docs`).
"""
SECTIONS = (
    ("The description", "wire", ("Wire",)),
    ("What a driver at the guard port may write", "driver", ("DriverLanguage",)),
    ("What failstop uses of a board", "interface", ("Board", "ServoBus")),
)
"""Title, module, and the classes that come first; the others follow as they stand there."""


def page() -> str:
    """The page."""
    parts = [PAGE_HEAD]
    for title, module, first in SECTIONS:
        found = _classes(module)
        parts.append(f"## {title}\n")
        for name in (*first, *(name for name in found if name not in first)):
            parts += _class(found[name], module)
    return "\n".join(parts)


def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Also those that only types need."""
    tree = ast.parse((PACKAGE / "board" / f"{module}.py").read_text())
    return {node.name: node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and node.name[0] != "_"}


def _class(node: ast.ClassDef, module: str) -> Iterator[str]:
    values = vars(importlib.import_module(f"failstop.board.{module}"))
    yield f"### {node.name}\n"
    yield f"{flat(ast.get_docstring(node) or '')}\n"
    optional = {ast.unparse(item.target) for item in node.body if isinstance(item, ast.AnnAssign) and item.value}
    given = [
        (name, f"{text} May be left out.".lstrip() if name.partition(":")[0] in optional else text)
        for name, text in fields(node)
    ]
    yield from table([*given, *members(node, node.name, values)])

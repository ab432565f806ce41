"""The page docs/reference/python.md: the Python API, from its docstrings."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator, Sequence

from failstop_lab.pages.rooms import PACKAGE

API = PACKAGE / "api"
PAGE_HEAD = """# Python: reference

Generated from the docstrings of `failstop/api` (`make docs`). The guide is [python.md](../python.md). If no
module is named, import the name from `failstop` itself: `from failstop import Robot`.
"""
SECTIONS = (
    ("Robot", "robot", ("Robot",)),
    ("asyncio", "robot", ("AsyncRobot",)),
    ("What drive() answers", "robot", ("Driving", "Preempted", "Blocked")),
    ("Why", "why", ("Why",)),
    ("State", "snapshot", ()),
    ("Arm", "arm", ("Arm",)),
    ("Events", "events", ("Event",)),
    ("Errors", "errors", ()),
)
"""Title, module, and the classes that are shown of it; none named: all."""
PAGE_OF = {"Calls": "robot", "Session": "session"}
"""Classes that are shown with the first one that is made of them."""
FIRST = {"snapshot": ("State",), "errors": ("FailstopError",)}


def page() -> str:
    """The page."""
    parts = [PAGE_HEAD]
    for title, module, names in SECTIONS:
        found = _classes(module)
        order = names or (*FIRST[module], *(name for name in found if name not in FIRST[module]))
        parts.append(f"## {title}\n")
        parts += [part for name in order for part in _class(found[name], module)]
    return "\n".join(parts)


def _classes(module: str) -> dict[str, ast.ClassDef]:
    tree = ast.parse((API / f"{module}.py").read_text())
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef) and node.name[0] != "_"}


def _class(node: ast.ClassDef, module: str) -> Iterator[str]:
    bases = [name for base in node.bases if (name := ast.unparse(base)) not in ("NamedTuple", "Exception", *PAGE_OF)]
    yield f"### {node.name}{f' ({bases[0]})' if bases else ''}\n"
    yield f"{flat(ast.get_docstring(node) or '')}\n"
    rows = [*fields(node), *sorted(_all_members(node, node.name, module), key=lambda row: row[0][0].islower())]
    yield from table(rows)


def table(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    """The lines of a table of names and what is said of each; none without rows."""
    if rows:
        yield "| | |\n|---|---|"
        yield from (
            f"| `{name.replace('|', chr(92) + '|')}` | {text.replace('|', chr(92) + '|')} |" for name, text in rows
        )
        yield ""


def fields(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Fields, and members of an enumeration, with the text that follows each."""
    for at, item in enumerate(node.body):
        name = ""
        if isinstance(item, ast.AnnAssign):
            name = f"{ast.unparse(item.target)}: {ast.unparse(item.annotation)}"
        elif isinstance(item, ast.Assign):
            name = ast.unparse(item.targets[0])
        if name and not name.startswith("_"):
            after = node.body[at + 1] if at + 1 < len(node.body) else None
            yield name, flat(_text(after))


def _text(node: ast.stmt | None) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        return node.value.value
    return ""


def _all_members(node: ast.ClassDef, name: str, module: str) -> Iterator[tuple[str, str]]:
    """Its own, then those of what it is made of. The constructor is the one that has a capital."""
    yield from members(node, name, vars(importlib.import_module(f"failstop.api.{module}")))
    for base in map(ast.unparse, node.bases):
        if (home := PAGE_OF.get(base)) and name != "AsyncRobot":
            yield from _all_members(_classes(home)[base], name, home)


def members(node: ast.ClassDef, name: str, values: dict[str, object]) -> Iterator[tuple[str, str]]:
    """Methods and properties; what begins with an underscore is nobody's."""
    for item in node.body:
        if not isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if item.name == "__init__" and (told := ast.get_docstring(item)):
            yield f"{name}{_signature(item, values)}", flat(told)
        if item.name.startswith("_"):
            continue
        marks = {ast.unparse(mark) for mark in item.decorator_list}
        before = "await " if isinstance(item, ast.AsyncFunctionDef) else ""
        returns = ast.unparse(item.returns) if item.returns else ""
        if "property" in marks:
            yield f"{item.name}: {returns}", flat(ast.get_docstring(item) or "")
        else:
            arrow = f" -> {returns}" if returns not in ("None", "") else ""
            yield f"{before}{item.name}{_signature(item, values)}{arrow}", flat(ast.get_docstring(item) or "")


def _signature(node: ast.FunctionDef | ast.AsyncFunctionDef, values: dict[str, object]) -> str:
    """Without `self`, and without annotations, which the text says in words."""
    given = node.args
    plain = [argument.arg for argument in given.args][1:]
    defaults = [_value(default, values) for default in given.defaults]
    first = len(plain) - len(defaults)
    parts = [f"{name}={defaults[at - first]}" if at >= first else name for at, name in enumerate(plain)]
    if given.vararg:
        parts.append(f"*{given.vararg.arg}")
    elif given.kwonlyargs:
        parts.append("*")
    for argument, default in zip(given.kwonlyargs, given.kw_defaults, strict=True):
        parts.append(f"{argument.arg}={_value(default, values)}" if default else argument.arg)
    return f"({', '.join(parts)})"


def _value(node: ast.expr, values: dict[str, object]) -> str:
    """A default; a name of the module by its value."""
    return repr(values[node.id]) if isinstance(node, ast.Name) else ast.unparse(node)


def flat(text: str) -> str:
    """On one line."""
    return " ".join(text.split())

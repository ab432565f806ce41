"""No code of the service stores into shared memory but by one slice assignment of ready bytes, or a word."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.support.rooms import ROOT, package
from tests.support.starting import nodes

IN_PLACE = frozenset(
    ("pack_into", "memmove", "memset", "from_buffer", "from_address", "write_byte", "string_at", "copyto", "putmask")
)
"""Stores in place: struct's zero-fills first, the rest go past the one slice assignment."""
STRUCT = frozenset(("Struct", "pack", "unpack", "unpack_from", "iter_unpack", "calcsize", "pack_into"))
SHARED = frozenset(("_view", "view", "mapped", "_mapped", "_cells"))
"""Attributes under which this project keeps shared memory."""
BIG_ENDIAN, SPLIT, TWICE = "big-endian format", "store that is no slice assignment", "a second store in one function"
ALLOWED = {
    ("shm/words.py", "memoryview"),  # a word's one store, which the module is about
    ("shm/bell.py", "memoryview"),  # read, of bytes from a pipe
    ("lab/failstop_lab/machine/memory.py", "memoryview"),  # the simulated machine's own, of one Python process
    ("lab/failstop_lab/machine/mapped.py", "memoryview"),  # likewise
    ("failstop/ros2/stencil.py", "pack_into"),  # a message for ROS, in a buffer of this process alone
    ("failstop/board/vesc/codec.py", BIG_ENDIAN),  # packets of a board that talks big-endian
    ("failstop/board/vesc/driver.py", BIG_ENDIAN),
    ("lab/failstop_lab/boards/vesc.py", BIG_ENDIAN),
}


def name(node: ast.AST) -> str:
    return getattr(node, "attr", "") or getattr(node, "id", "")


def wrong(node: ast.AST) -> Iterator[str]:
    said = [name(node)]
    if isinstance(node, ast.ImportFrom):
        said = [each.name for each in node.names]
    elif isinstance(node, ast.Constant):  # getattr(struct, "pack_into")
        said = [str(node.value)]
    yield from IN_PLACE & set(said)
    if isinstance(node, ast.Call):
        yield from {"memoryview"} & {name(node.func)}
        forms = [*node.args[:1], *(word.value for word in node.keywords)] if name(node.func) in STRUCT else []
        yield from [BIG_ENDIAN for form in forms if re.match(r"[fb('\"]+\s*[>!]", ast.unparse(form))]
    if isinstance(node, ast.Assign | ast.AugAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        stores = [part for each in targets for part in getattr(each, "elts", [each]) if isinstance(part, ast.Subscript)]
        whole = isinstance(node, ast.Assign) and all(isinstance(store.slice, ast.Slice) for store in stores)
        yield from [SPLIT for store in stores if name(store.value) in SHARED and not whole]
    if isinstance(node, ast.FunctionDef):
        stores = [each for each in nodes(node) if isinstance(each, ast.Subscript) and isinstance(each.ctx, ast.Store)]
        yield from [TWICE for _ in [each for each in stores if name(each.value) in SHARED][1:]]


def read(text: str) -> set[str]:
    return {what for node in nodes(ast.parse(text)) for what in wrong(node)}


@pytest.mark.slow
def test_no_room_packs_in_place() -> None:
    paths = [str(path.relative_to(ROOT)) for path in package()]
    assert len(paths) > 100
    served = [path for path in paths if not path.startswith("lab/failstop_lab/sim/")]  # a board, which shares no memory
    assert {(path, what) for path in served for what in read((ROOT / path).read_text())} == ALLOWED


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("HEAD.pack_into(mapped, at, crc, length)", "pack_into"),
        ("from struct import pack_into as store", "pack_into"),
        ("getattr(struct, 'pack_into')('<I', view, 0, 1)", "pack_into"),
        ("def f(self):\n    class A:\n        def g(self): return [s.pack_into(b, 0) for s in x]", "pack_into"),
        ("cell = (ctypes.c_char * 8).from_address(at)", "from_address"),
        ("struct.Struct('>QQ')", BIG_ENDIAN),
        ("unpack_from(b' !H', raw)", BIG_ENDIAN),
        ("struct.Struct(f'>{n}d')", BIG_ENDIAN),
        ("struct.Struct('>' + 'I' * n)", BIG_ENDIAN),
        ("struct.Struct(format='>I')", BIG_ENDIAN),
        ("memoryview(mapped).cast('Q')[3] = 1", "memoryview"),
        ("self._view[3] = 1", SPLIT),
        ("self._view[0:8] += data", SPLIT),
        ("segment.mapped[at], x = 1, 2", SPLIT),
        ("def f(self):\n    self._view[0:24] = header\n    self._view[24:88] = payload", TWICE),
        ("HEAD = struct.Struct('<IIQQ')\nraw = HEAD.pack(1, 2, 3, 4)", None),
        ("self._view[at : at + len(data)] = data", None),
        ("table['>'] = 1\nnames[3] = 'x'\na > b", None),
        ("'never call struct.pack_into here'", None),
    ],
)
def test_a_planted_violation_is_found(text: str, what: str | None) -> None:
    assert read(text) == ({what} if what else set())

"""No code of the service stores into shared memory but by one slice assignment of ready bytes, or a word."""

from __future__ import annotations

import os

import pytest

from .packing import ROOMS, read, sources

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

ALLOWED = {
    # A word's one store, which the module is about.
    ("shm/words.py", "store through a memoryview"),
    # The simulated machine's own, of one Python process.
    ("failstop/lab/machine/mapped.py", "store through a memoryview"),
    # A message for ROS, in a buffer of this process alone.
    ("failstop/ros2/stencil.py", "pack_into"),
}


@pytest.mark.slow
def test_no_room_packs_in_place() -> None:
    found = []
    for path in sources(ROOT):
        with open(os.path.join(ROOT, path), encoding="utf-8") as file:
            found += read(path, file.read())
    assert [finding for finding in found if (finding.path, finding.what) not in ALLOWED] == []
    assert {(finding.path, finding.what) for finding in found} == ALLOWED, "an exception that nothing needs any more"


def test_the_sources_are_all_read() -> None:
    paths = list(sources(ROOT))
    assert len(paths) == len(set(paths)) > 30
    assert {path.split("/")[0] for path in paths} == set(ROOMS)
    for path in ("shm/cell.py", "failstop/board/codec.py", "procs/port_owner/main.py", "failstop/api/client.py"):
        assert path in paths
    assert not [path for path in paths if path.startswith("failstop/shm")]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("import struct\nstruct.pack_into('<I', view, 0, 1)", "pack_into"),
        ("HEAD.pack_into(mapped, at, crc, length)", "pack_into"),
        ("from struct import pack_into", "pack_into"),
        ("from struct import pack_into as store\nstore('<I', view, 0, 1)", "pack_into"),
        ("getattr(struct, 'pack_into')('<I', view, 0, 1)", "pack_into"),
        ("put = HEAD.pack_into", "pack_into"),
        ("def f(self):\n    class A:\n        def g(self): return [s.pack_into(b, 0) for s in x]", "pack_into"),
        ("ctypes.memmove(address, data, 8)", "memmove"),
        ("from ctypes import memset", "memset"),
        ("cell = ctypes.c_uint64.from_buffer(mapped, 64)", "from_buffer"),
        ("cell = (ctypes.c_char * 8).from_address(at)", "from_address"),
        ("mapped.write_byte(1)", "write_byte"),
        ("struct.Struct('>QQ')", "big-endian format"),
        ("struct.pack('!I', 1)", "big-endian format"),
        ("from struct import Struct\nA = Struct(b'>I')", "big-endian format"),
        ("from struct import unpack_from as take\nimport struct\nstruct.unpack_from(' !H', raw)", "big-endian format"),
        ("struct.Struct(f'>{n}d')", "big-endian format"),
        ("struct.Struct('>' + 'I' * n)", "big-endian format"),
        ("FORM = '!Q'\nHEAD = struct.Struct(FORM)", "big-endian format"),
        ("struct.Struct(format='>I')", "big-endian format"),
        ("struct.iter_unpack('>f', data)", "big-endian format"),
        ("memoryview(mapped)[0:8] = data", "store through a memoryview"),
        ("memoryview(mapped).cast('Q')[3] = 1", "store through a memoryview"),
        ("cells = memoryview(mapped).cast('Q')\ncells[3] = 1", "store through a memoryview"),
        ("self.cells = memoryview(mapped)[64:]\nself.cells[0] += 1", "store through a memoryview"),
        ("self._view[3] = 1", "store into shared memory that is not one slice assignment"),
        ("self._view[0:8] += data", "store into shared memory that is not one slice assignment"),
        ("segment.mapped[at], x = 1, 2", "store into shared memory that is not one slice assignment"),
        (
            "def f(self):\n    self._view[0:24] = header\n    self._view[24:88] = payload",
            "a second store into shared memory in one function",
        ),
    ],
)
def test_a_planted_violation_is_found(text: str, what: str) -> None:
    assert what in [finding.what for finding in read("planted.py", text)]


@pytest.mark.parametrize(
    "text",
    [
        "import struct\nHEAD = struct.Struct('<IIQQ')\nraw = HEAD.pack(1, 2, 3, 4)",
        "struct.Struct('hhqqi4x')",
        "struct.Struct(f'<{n}d').unpack(data)",
        "self._view[at : at + len(data)] = data",
        "value = memoryview(data)[3:]\nos.write(fd, value)",
        "a > b and not c",
        "table['>'] = 1\nnames[3] = 'x'",
        "msgpack.packb({'>': '!'})",
        "'never call struct.pack_into here'",
    ],
)
def test_what_is_right_is_let_be(text: str) -> None:
    assert read("right.py", text) == []


def test_a_violation_planted_in_a_room_is_found_on_the_way_the_check_goes(tmp_path: object) -> None:
    root = str(tmp_path)
    for room in ROOMS:
        os.makedirs(f"{root}/{room}/deep/er")
        with open(f"{root}/{room}/deep/er/bad.py", "w", encoding="utf-8") as file:
            file.write("import struct\nstruct.pack_into('<I', view, 0, 1)\n")
    os.symlink(f"{root}/shm", f"{root}/failstop/shm")
    found = []
    for path in sources(root):
        with open(f"{root}/{path}", encoding="utf-8") as file:
            found += read(path, file.read())
    assert sorted(finding.path for finding in found) == sorted(f"{room}/deep/er/bad.py" for room in ROOMS)

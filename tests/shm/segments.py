"""Segments for tests: their files, headers that do not fit, and how an attempt is refused."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from failstop.messages import segments
from failstop.messages.layout import CLIENT_HASH, LAYOUT_HASH, PRIVATE, PUBLIC, SEGMENT_BY_NAME, SEGMENTS
from failstop.messages.segments import AttachError
from failstop.shm import cell
from failstop.shm.segment import Segment
from failstop.version import VERSION

RUN = 0xABCDEF0123456789
NAMES = [spec.name for spec in SEGMENTS]
HEADER, HEADER_SEED = struct.Struct("<8sQQQ16sQ24s"), cell.seed("header", 0)

SERVICE = [spec.name for spec in SEGMENTS if spec.mode == PUBLIC]
PRIVATE_NAMES = [spec.name for spec in SEGMENTS if spec.mode == PRIVATE]


def path_of(instance: str, of: str) -> str:
    return segments.path_of(instance, of)


def content(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def create_all(instance: str, run: int = RUN) -> None:
    for of in NAMES:
        segments.create(instance, of, run).close()


def refusal(attempt: Callable[[], object]) -> tuple[str, str]:
    with pytest.raises(AttachError) as refused:
        attempt()
    assert "\n" not in str(refused.value)
    return refused.value.kind, str(refused.value)


def write_header(
    instance: str,
    of: str,
    *,
    magic: bytes = segments.MAGIC,
    layout: int = LAYOUT_HASH,
    size: int | None = None,
    run: int = RUN,
    name: str | None = None,
    version: str = VERSION,
) -> None:
    """Put a header of another program, run or layout into a segment."""
    size = SEGMENT_BY_NAME[of].size if size is None else size
    header = HEADER.pack(magic, layout, size, run, (name or of).encode(), CLIENT_HASH, version.encode())
    with open(path_of(instance, of), "r+b") as file:
        file.write(cell.build(1, 0, header, HEADER_SEED, 104))


def attach_any(name: str, of: str, run: int = RUN) -> Segment:
    return segments.attach(name, of, run, write=of.startswith("client."))

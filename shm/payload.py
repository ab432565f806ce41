"""Payload: what a record holds, declared once: its values, how they become bytes and bytes become them, its size."""

from __future__ import annotations

import struct

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, Generic

    from typing_extensions import TypeVarTuple, Unpack

    Values = TypeVarTuple("Values")


class Tail:
    """What follows the numbers: how its values become bytes, and bytes its values (ValueError: not these bytes)."""

    __slots__ = ("pack", "unpack")

    def __init__(self, pack: Callable[..., bytes], unpack: Callable[[bytes], tuple[Any, ...]]) -> None:
        self.pack = pack
        self.unpack = unpack


REST = Tail(bytes, lambda data: (data,))
"""Bytes, as they are."""


class Shape:
    """Numbers in the form of `struct`, and the tail's values after them. `pack` takes what `unpack` returns; `unpack`
    raises ValueError for bytes of another shape, so that a reader takes them for damage. `size`: of the numbers."""

    __slots__ = ("pack", "size", "unpack")

    def __init__(self, form: str, tail: Tail | None = None) -> None:
        numbers = struct.Struct(form)
        self.size = numbers.size
        self.pack: Callable[..., bytes]
        self.unpack: Callable[[bytes], tuple[Any, ...]]
        if tail is None:
            self.pack, self.unpack = numbers.pack, _exact(numbers)
        elif tail is REST:
            self.pack, self.unpack = _packing_rest(numbers), _with_rest(numbers)
        else:
            self.pack, self.unpack = _with_tail(numbers, tail)


def _count(numbers: struct.Struct) -> int:
    return len(numbers.unpack(bytes(numbers.size)))


def _exact(numbers: struct.Struct) -> Callable[[bytes], tuple[Any, ...]]:
    size, unpack = numbers.size, numbers.unpack

    def exact(payload: bytes) -> tuple[Any, ...]:
        if len(payload) != size:
            raise ValueError(f"payload of {len(payload)} bytes, {size} expected")
        return unpack(payload)

    return exact


def _packing_rest(numbers: struct.Struct) -> Callable[..., bytes]:
    """One for each count of numbers: the arguments as a tuple take twice the time, on the way of every frame."""
    pack = numbers.pack
    by_count: dict[int, Callable[..., bytes]] = {
        1: lambda a, rest: pack(a) + rest,
        2: lambda a, b, rest: pack(a, b) + rest,
        3: lambda a, b, c, rest: pack(a, b, c) + rest,
    }
    return by_count[_count(numbers)]


def _with_rest(numbers: struct.Struct) -> Callable[[bytes], tuple[Any, ...]]:
    size, unpack = numbers.size, numbers.unpack_from

    def with_rest(payload: bytes) -> tuple[Any, ...]:
        if len(payload) < size:
            raise ValueError(f"payload of {len(payload)} bytes, at least {size} expected")
        return (*unpack(payload), payload[size:])

    return with_rest


def _with_tail(numbers: struct.Struct, tail: Tail) -> tuple[Callable[..., bytes], Callable[[bytes], tuple[Any, ...]]]:
    count, unpack = _count(numbers), _with_rest(numbers)

    def pack(*values: Any) -> bytes:
        return numbers.pack(*values[:count]) + tail.pack(*values[count:])

    def with_tail(payload: bytes) -> tuple[Any, ...]:
        found = unpack(payload)
        return found[:-1] + tail.unpack(found[-1])

    return pack, with_tail


if TYPE_CHECKING:

    class Payload(Shape, Generic[Unpack[Values]]):
        """A shape of these values, as the type checker sees it."""

        pack: Callable[[Unpack[Values]], bytes]
        unpack: Callable[[bytes], tuple[Unpack[Values]]]

else:
    Payload = Shape

"""Stencil: a message that is published again and again, while only a few of its numbers change.

rclpy takes 0.1 ms to serialize a message, so a stencil serializes the message once and then writes new numbers into the
bytes. To find the places in the bytes, the message is serialized with numbers that occur nowhere else. If ROS can't
serialize the message, or if the numbers are not found, the message object itself is changed and published.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

FORMATS = {"double": "d", "float": "f", "int32": "i", "uint32": "I"}
"""The number types of ROS, with their format characters in struct."""
MARK = 70_000
"""The smallest number that is used for searching the bytes. Every float and integer type can hold such numbers, and no
length in a message is as large."""
Values = Sequence[Sequence[float]]


def serializer() -> Callable[[Any], bytes] | None:
    """rclpy's function that serializes a message. None if this rclpy has none."""
    try:
        from rclpy.serialization import serialize_message
    except ImportError:
        return None
    found: Callable[[Any], bytes] = serialize_message
    return found


class Stencil:
    """One message. `places`: the dotted names of the fields that change. Such a field is a number, an array of numbers,
    or a message with only numbers."""

    def __init__(self, message: Any, places: Sequence[str], serialize: Callable[[Any], bytes] | None) -> None:
        self._message = message
        self._places = places
        self._bytes = bytearray()
        self._writes: list[tuple[Callable[..., None], int]] = []
        if serialize:
            self._find(serialize)

    def _find(self, serialize: Callable[[Any], bytes]) -> None:
        marks = itertools.count(MARK)
        wanted = []
        for place in self._places:
            form = _form(*_field(self._message, place))
            values = [next(marks) if sign in "iI" else next(marks) + 0.5 for sign in form]
            self._put(place, values)
            wanted.append((struct.Struct(f"<{form}"), values))
        data = bytearray(serialize(self._message))
        for form_there, values in wanted:
            pattern = form_there.pack(*values)
            if data.count(pattern) != 1:
                return
            self._writes.append((form_there.pack_into, data.index(pattern)))
        self._bytes = data

    def _put(self, place: str, values: Sequence[float]) -> None:
        _put(*_field(self._message, place), iter(values))

    def filled(self, values: Values) -> Any:
        """The message to publish, as bytes or as a message object. `values`: the numbers for each place, in the order
        of the places."""
        if self._bytes:
            for (write, at), numbers in zip(self._writes, values, strict=True):
                write(self._bytes, at, *numbers)
            return bytes(self._bytes)
        for place, numbers in zip(self._places, values, strict=True):
            self._put(place, numbers)
        return self._message


def _field(message: Any, place: str) -> tuple[Any, str]:
    """The object that has the field, and the field's name. A number in the dotted name is an index."""
    *above, last = place.split(".")
    for name in above:
        message = message[int(name)] if name.isdigit() else getattr(message, name)
    return message, last


def _is_message(value: Any) -> bool:
    return hasattr(value, "get_fields_and_field_types")


def _form(owner: Any, name: str) -> str:
    """The format string of struct for the numbers of this field."""
    value, kind = getattr(owner, name), owner.get_fields_and_field_types()[name]
    if _is_message(value):
        return "".join(_form(value, field) for field in value.get_fields_and_field_types())
    if kind in FORMATS:
        return FORMATS[kind]
    return FORMATS[kind.removeprefix("sequence<").partition("[")[0].rstrip(">")] * len(value)


def _put(owner: Any, name: str, values: Iterator[float]) -> None:
    value = getattr(owner, name)
    if _is_message(value):
        for field in value.get_fields_and_field_types():
            _put(value, field, values)
    elif isinstance(value, (int, float)):
        setattr(owner, name, next(values))
    else:
        setattr(owner, name, [next(values) for _ in value])

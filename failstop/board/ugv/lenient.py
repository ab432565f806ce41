"""Reads JSON from a driver's line as ArduinoJson does, which accepts more than JSON.

ArduinoJson (6.21, 7.2) accepts single quotes, keys without quotes, numbers with a plus, and numbers without digits on
one side of the point. It ignores everything after the first value, unless this value is a number. A NUL byte ends the
line. This module refuses everything that ArduinoJson refuses, because a motion that the board would ignore must not
turn a wheel.
"""

from __future__ import annotations

import re

_MOST_DEEP = 10
_BLANK = re.compile(rb"[ \t\r\n]*")
_KEY = re.compile(rb"[0-9A-Za-z_]+")
_LITERAL = re.compile(rb"true|false|null")
_NUMBER = re.compile(rb"([+-]?)(\d*)(?:(\.)(\d*))?(?:[eE]([+-]?)(\d*))?")
_IN_NUMBER = re.compile(rb"[0-9+.eE-]*")
_LONGEST_NUMBER = 63
"""The longest number that ArduinoJson has room for, in bytes."""
_MOST_POWER = 400
_VALUES = {b"true": True, b"false": False, b"null": None}
_ESCAPES = {ord("b"): 8, ord("f"): 12, ord("n"): 10, ord("r"): 13, ord("t"): 9}


class NotTaken(ValueError):
    """Raised for a line that the board would ignore."""


def loads(line: bytes) -> object:
    """Return the first value in a line. Texts and the keys of objects are bytes. Raises NotTaken."""
    text = line.split(b"\0", 1)[0]
    value, at = _value(text, 0, _MOST_DEEP)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if number and text[at:]:
        raise NotTaken("a number that goes on")
    return value


def _blank(text: bytes, at: int) -> int:
    found = _BLANK.match(text, at)
    return found.end() if found else at


def _value(text: bytes, at: int, deep: int) -> tuple[object, int]:
    at = _blank(text, at)
    first = text[at : at + 1]
    if first in (b"{", b"["):
        if not deep:
            raise NotTaken("too deep")
        return _object(text, at + 1, deep - 1) if first == b"{" else _array(text, at + 1, deep - 1)
    if first in (b"'", b'"'):
        return _text(text, at)
    if literal := _LITERAL.match(text, at):
        return _VALUES[literal[0]], literal.end()
    if not first:
        raise NotTaken("nothing")
    return _number(text, at)


def _object(text: bytes, at: int, deep: int) -> tuple[dict[bytes, object], int]:
    found: dict[bytes, object] = {}
    at = _blank(text, at)
    if text[at : at + 1] == b"}":
        return found, at + 1
    while True:
        key: object
        if text[at : at + 1] in (b"'", b'"'):
            key, at = _text(text, at)
        elif bare := _KEY.match(text, at):
            key, at = bare[0], bare.end()
        else:
            raise NotTaken("no key")
        at = _next(text, at, b":")
        assert isinstance(key, bytes)
        found[key], at = _value(text, at, deep)
        at = _blank(text, at)
        if text[at : at + 1] == b"}":
            return found, at + 1
        at = _blank(text, _next(text, at, b","))


def _array(text: bytes, at: int, deep: int) -> tuple[list[object], int]:
    found: list[object] = []
    at = _blank(text, at)
    if text[at : at + 1] == b"]":
        return found, at + 1
    while True:
        value, at = _value(text, at, deep)
        found.append(value)
        at = _blank(text, at)
        if text[at : at + 1] == b"]":
            return found, at + 1
        at = _next(text, at, b",")


def _next(text: bytes, at: int, wanted: bytes) -> int:
    at = _blank(text, at)
    if text[at : at + 1] != wanted:
        raise NotTaken("something else was expected")
    return at + 1


def _text(text: bytes, at: int) -> tuple[bytes, int]:
    quote, found = text[at], bytearray()
    at += 1
    while at < len(text):
        byte = text[at]
        at += 1
        if byte == quote:
            return bytes(found), at
        if byte == ord("\\"):
            if at >= len(text) or text[at] == ord("u"):
                raise NotTaken("no command has such a text")
            byte = _ESCAPES.get(text[at], text[at])
            at += 1
        found.append(byte)
    raise NotTaken("a text without an end")


def _number(text: bytes, at: int) -> tuple[int | float, int]:
    found = _IN_NUMBER.match(text, at)
    word = found[0][:_LONGEST_NUMBER] if found else b""
    return number(word), at + len(word)


def number(word: bytes) -> int | float:
    """Return the value of a number that is written as text. Raises NotTaken."""
    found = _NUMBER.fullmatch(word)
    if not found or not word.lstrip(b"+-") or word.lstrip(b"+-")[:1] in (b"e", b"E"):
        raise NotTaken("no number")
    sign, whole, point, part, minus, power = found.groups()
    factor = -1 if sign == b"-" else 1
    if point is None and minus is None and power is None:
        return factor * int(whole)
    exponent = min(int(power or b"0"), _MOST_POWER)
    return factor * float(b"%s.%se%s%d" % (whole or b"0", part or b"0", minus or b"", exponent))

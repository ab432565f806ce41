"""JSON as ArduinoJson reads it from a line, as far as a board's commands need it (versions 6.21 and 7.2).

It is more lenient than JSON: single quotes, keys without quotes, anything behind the first value, numbers with a plus
or without digits on one side of the point. A NUL byte ends the line.
"""

from __future__ import annotations

import re

Json = object
DEEPEST = 10
_SPACES = b" \t\r\n"
_KEY = re.compile(rb"[0-9A-Z_`a-z]+")
_IN_NUMBER = re.compile(rb"[0-9+\-.eE]{0,63}")
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d*)(?:[eE][+-]?\d*)?")
_ESCAPED = {ord(name): code for name, code in zip("bfnrt", b"\b\f\n\r\t", strict=True)}
_KEYWORDS = {b"true": True, b"false": False, b"null": None}


class NotJson(ValueError):
    """ArduinoJson returns an error, and the line is ignored."""


class _Text:
    """A line, and how far it was read."""

    def __init__(self, line: bytes) -> None:
        self.line = line.partition(b"\0")[0]
        self.at = 0

    def peek(self) -> int:
        """The next byte; 0 at the end."""
        return self.line[self.at] if self.at < len(self.line) else 0

    def take(self, value: bytes) -> bool:
        """Whether this byte was next; it is read then."""
        found = self.peek() == value[0]
        self.at += found
        return found

    def skip_spaces(self) -> None:
        """To the next byte that is none. Raises NotJson at the end."""
        while (byte := self.peek()) in _SPACES and byte:
            self.at += 1
        if not byte:
            raise NotJson

    def match(self, pattern: re.Pattern[bytes]) -> bytes:
        """The text that matches here; it is read."""
        found = pattern.match(self.line, self.at)
        text = found[0] if found else b""
        self.at += len(text)
        return text


def loads(line: bytes) -> Json:
    """The value of a line. Raises NotJson."""
    text = _Text(line)
    value = _value(text, DEEPEST)
    # A number could go on; the line feed behind it is already too much.
    if isinstance(value, (int, float)) and not isinstance(value, bool) and text.peek():
        raise NotJson
    return value


def _value(text: _Text, depth: int) -> Json:
    text.skip_spaces()
    if text.peek() in b"[{" and not depth:
        raise NotJson
    if text.take(b"{"):
        return _object(text, depth - 1)
    if text.take(b"["):
        return _array(text, depth - 1)
    if text.peek() in b"'\"":
        return _quoted(text)
    for word, value in _KEYWORDS.items():
        if text.peek() == word[0]:
            if not text.line.startswith(word, text.at):
                raise NotJson
            text.at += len(word)
            return value
    return number_text(text.match(_IN_NUMBER))


def _object(text: _Text, depth: int) -> dict[bytes, Json]:
    found: dict[bytes, Json] = {}
    text.skip_spaces()
    if text.take(b"}"):
        return found
    while True:
        key = _quoted(text) if text.peek() in b"'\"" else text.match(_KEY)
        quoted = text.line[text.at - 1 : text.at] in (b"'", b'"')
        if not key and not quoted:
            raise NotJson
        text.skip_spaces()
        if not text.take(b":"):
            raise NotJson
        found[key] = _value(text, depth)
        text.skip_spaces()
        if text.take(b"}"):
            return found
        if not text.take(b","):
            raise NotJson
        text.skip_spaces()


def _array(text: _Text, depth: int) -> list[Json]:
    found: list[Json] = []
    text.skip_spaces()
    if text.take(b"]"):
        return found
    while True:
        found.append(_value(text, depth))
        text.skip_spaces()
        if text.take(b"]"):
            return found
        if not text.take(b","):
            raise NotJson


def _quoted(text: _Text) -> bytes:
    quote = text.peek()
    text.at += 1
    found = bytearray()
    while (byte := text.peek()) != quote:
        text.at += 1
        if byte == ord("\\"):
            byte = text.peek()
            byte = _ESCAPED.get(byte, byte)
            text.at += 1
            if byte == ord("u"):
                raise NotJson  # not modelled: no command has such a text
        if not byte:
            raise NotJson
        found.append(byte)
    text.at += 1
    return bytes(found)


def number_text(text: bytes) -> int | float:
    """A number's text. Raises NotJson."""
    if not _NUMBER.fullmatch(text):
        raise NotJson
    if text.lstrip(b"+-").isdigit():
        return int(text)
    mantissa, _, exponent = text.lower().partition(b"e")
    sign = -1.0 if mantissa.startswith(b"-") else 1.0
    whole, _, part = mantissa.lstrip(b"+-").partition(b".")
    power = int(exponent) if exponent.strip(b"+-") else 0
    # Neither side of the point needs a digit.
    return sign * float(b"%s.%se%d" % (whole or b"0", part or b"0", power))

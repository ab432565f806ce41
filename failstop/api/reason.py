"""Reason: turns anything that a program gives as the reason of a stop into text.

A text, a number or an exception is converted here without calling the program's own code, which could raise or take its
time while the stop waits. That code is called when the stop is out.
"""

from __future__ import annotations

from types import FunctionType

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

LOOKED_AT = 1000
"""Characters of a text that are looked at; a request has room for fewer."""
LONGEST_BITS = 64
"""Longest number that is shown, in bits. Python refuses to convert one with thousands of digits."""


def plain(reason: object) -> tuple[str, bool]:
    """The text that needs no code of the program, and whether it is complete. Never raises."""
    try:
        return _of_exception(reason) if issubclass(type(reason), BaseException) else _of_object(reason)
    except Exception:  # even the name of a class can be code, through its metaclass
        return "", False


def own(reason: object) -> str:
    """The object's text by its own `__str__`; empty if it has none. May raise anything, and may never return."""
    kind = type(reason)
    if kind.__str__ is object.__str__ and kind.__repr__ is object.__repr__:
        return ""
    words = str.__str__(str(reason))[:LOOKED_AT]
    return f"{kind.__name__}: {words}" if words and issubclass(kind, BaseException) else words


def _of_exception(reason: object) -> tuple[str, bool]:
    """The exception's class and arguments. An exception with its own `__str__`, or with an object as an argument, has
    more to say."""
    kind = type(reason)
    arguments = BaseException.args.__get__(reason)  # type: ignore[attr-defined]  # whatever the class calls `args`
    told = [words for each in arguments if (words := _builtin(each)) is not None]
    whole = len(told) == len(arguments) and not isinstance(kind.__str__, FunctionType)
    made_of = ", ".join(filter(None, told))
    return f"{kind.__name__}: {made_of}" if made_of else kind.__name__, whole


def _of_object(reason: object) -> tuple[str, bool]:
    words = _builtin(reason)
    return (type(reason).__name__, False) if words is None else (words, True)


def _builtin(value: Any) -> str | None:
    """The text of a string, a number or None; None for any other object."""
    kind = type(value)
    if value is None:
        return ""
    # By the methods of the builtin classes, because a subclass may override them with anything.
    words: str | None = None
    if issubclass(kind, str):
        words = str.__getitem__(value, slice(LOOKED_AT))
    elif issubclass(kind, bytes):
        words = bytes.__getitem__(value, slice(LOOKED_AT)).decode("utf-8", "replace")
    elif issubclass(kind, float):
        words = float.__repr__(value)
    elif kind is bool or (kind is int and value.bit_length() <= LONGEST_BITS):
        words = repr(value)
    return words

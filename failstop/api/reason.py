"""Reason: makes a text from any object that a program gives as the reason for a stop.

The stop must not wait for the program's own code, which may be slow or raise an error. So the first text comes from a
string, a number or an exception, without calling such code. An object's own `__str__` is called only after the stop was
sent.
"""

from __future__ import annotations

from types import FunctionType

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

LOOKED_AT = 1000
"""How many characters of a text are used; the rest is cut. A stop request has room for even fewer."""
LONGEST_BITS = 64
"""The longest integer that is converted to text, in bits. Python itself refuses to convert an integer with thousands of
digits."""


def plain(reason: object) -> tuple[str, bool]:
    """Return (text, whole): the text that can be made without calling the program's code, and True if nothing is
    missing from it. Never raises."""
    try:
        return _of_exception(reason) if issubclass(type(reason), BaseException) else _of_object(reason)
    except Exception:  # even the class's name can be code, if it has a metaclass
        return "", False


def own(reason: object) -> str:
    """The text that str() makes of the object. Empty if its class has neither a `__str__` nor a `__repr__` of its own.
    This runs the program's code, so it may raise any error, or never return."""
    kind = type(reason)
    if kind.__str__ is object.__str__ and kind.__repr__ is object.__repr__:
        return ""
    words = str.__str__(str(reason))[:LOOKED_AT]
    return f"{kind.__name__}: {words}" if words and issubclass(kind, BaseException) else words


def _of_exception(reason: object) -> tuple[str, bool]:
    """plain() for an exception: the text of its class and arguments. `whole` is False if the exception has its own
    `__str__`, or if plain() can't make the text of an argument."""
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
    """The text of a string, bytes, a number or None. Returns None for any other object, and also for an int that is
    longer than LONGEST_BITS or of a subclass of int."""
    kind = type(value)
    if value is None:
        return ""
    # Call the methods of the builtin classes directly, because a subclass may have replaced them.
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

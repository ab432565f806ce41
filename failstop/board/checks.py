"""Checks for the values that an encoder puts into a frame.

Each check raises FrameError for a value that must not reach the board.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence


class FrameError(ValueError):
    """Raised for a value that must not reach the board. The message names the field, the value and the allowed
    range."""


def integer(field: str, value: int, low: int, high: int) -> int:
    """Return the value if it is an integer from low to high, else raise FrameError. A bool does not count as an
    integer."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise FrameError(f"{field} is {value!r}, must be an integer from {low} to {high}")
    return value


def number(field: str, value: float, low: float, high: float, unit: str) -> float:
    """Return the value as a float if it is from low to high, else raise FrameError. NaN and bool are not numbers. Minus
    zero becomes zero."""
    real = isinstance(value, (int, float)) and not isinstance(value, bool)
    # The chained comparison is false for NaN.
    if not real or not low <= value <= high:
        raise FrameError(f"{field} is {value!r}, must be a finite number from {low:g} to {high:g} {unit}")
    return value + 0.0


def counted(field: str, values: Sequence[object], low: int, high: int) -> int:
    """Return the number of values if it is from low to high, else raise FrameError."""
    try:
        count = len(values)
    except TypeError:
        raise FrameError(f"{field} is {values!r}, must be a sequence of {low} to {high}") from None
    if not low <= count <= high:
        raise FrameError(f"{field} has {count} entries, must have {low} to {high}")
    return count


def group(field: str, value: Sequence[object], size: int) -> None:
    """Raise FrameError unless the value is a tuple or list of `size` parts."""
    if not isinstance(value, (tuple, list)) or len(value) != size:
        raise FrameError(f"{field} is {value!r}, must be a tuple of {size} values")


def distinct(field: str, ids: Sequence[int]) -> None:
    """Raise FrameError if an id appears twice. In a frame that sets values, only the later of the two values would
    count."""
    for at, value in enumerate(ids):
        if value in ids[:at]:
            raise FrameError(f"{field} {value} appears twice, must appear at most once")

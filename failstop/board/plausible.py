"""Plausible: decides which values in a board's report are possible on a robot. Pure.

A board may report impossible values, for example because its battery is not connected, its memory is garbled, or the
reader of your own board has a bug. An impossible value is neither passed on nor clamped. It counts as not reported and
becomes HEARD_ODD, which the service logs once. So later code can rely on finite numbers within the limits below. For an
impossible battery voltage, HEARD_BATTERY with 0 mV is reported too. It means that no battery is connected.
"""

from __future__ import annotations

from math import isfinite

from failstop.board.interface import HEARD_BATTERY, HEARD_IMU, HEARD_ODD

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable

    from failstop.board.interface import Said

LEAST_V, MOST_V = 1.0, 1000.0
"""The limits for a battery's voltage. A voltage below LEAST_V drives no motor. For example, a board that is powered
only by USB measures a few hundredths of a volt. failstop then says that no battery is connected, instead of warning of
an empty battery."""
MOST_G, MOST_DPS = 1000.0, 100_000.0
"""The limits for an IMU's acceleration and turn rate. They are about 30 times what such sensors measure."""
MOST_COUNT = 1e15
"""The limit for a wheel's speed or position, in any unit. Below this limit, a float can still hold every whole number
exactly."""
MOST_REPORTED_WHEELS = 16
MOST_HEALTH_ROWS = 16
LONGEST_ODD_TEXT = 60
"""How many characters of an impossible value, or of a text about a restart, are shown."""
MOST_ODD_VALUES = 8
"""How many impossible values are shown, if there are several."""
IMPOSSIBLE = (TypeError, ValueError, OverflowError, AttributeError, LookupError)
"""The errors that are raised for a value that is not a number, too large, or missing."""


def finite(value: object, most: float) -> float:
    """Return the value as a float. Raises ValueError if the value is not a number from -most to most, and OverflowError
    if it is an integer that no float can hold. A bool is not a number."""
    if isinstance(value, bool) or not hasattr(value, "__float__"):
        raise ValueError("not a number")
    number = float(value)
    if not (isfinite(number) and -most <= number <= most):
        raise ValueError("not a number that this can be")
    return number


def finite_numbers(values: Iterable[object], most: float, least: int, count: int) -> tuple[float, ...]:
    """Return the values as finite floats. Raises one of IMPOSSIBLE if a value is impossible, or if there are fewer than
    `least` or more than `count` values."""
    found = []
    for value in values:
        found.append(finite(value, most))
        if len(found) > count:
            raise ValueError("too many numbers")
    if len(found) < least:
        raise ValueError("too few numbers")
    return tuple(found)


def whole_number(value: object, least: int, most: int) -> int:
    """Return the value as an integer. Raises ValueError if it is not an integer from `least` to `most`. A bool is not
    an integer."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ValueError("not an integer")
    number: int = value.__index__()
    if not least <= number <= most:
        raise ValueError("not an integer that this can be")
    return number


def battery_said(volts: object) -> list[Said]:
    """Return HEARD_BATTERY with the voltage in mV. An impossible voltage gives HEARD_BATTERY with 0 mV, and
    HEARD_ODD."""
    try:
        known = finite(volts, MOST_V)
        if known >= LEAST_V:
            return [(HEARD_BATTERY, (round(known * 1000),))]
        said = f"{known:.2f} V"
    except IMPOSSIBLE:
        said = odd_text(volts)
    return [(HEARD_BATTERY, (0,)), (HEARD_ODD, ("battery", said))]


def imu_said(sample: Iterable[object]) -> list[Said]:
    """Return HEARD_IMU for a sample of acceleration x y z in g and turn rate x y z in degrees per second. If a value is
    impossible, return HEARD_ODD."""
    values = tuple(sample)
    try:
        found = finite_numbers(values[:3], MOST_G, 3, 3) + finite_numbers(values[3:], MOST_DPS, 3, 3)
    except IMPOSSIBLE:
        return odd("IMU", values)
    return [(HEARD_IMU, found)]


def odd(what: str, value: object) -> list[Said]:
    """Return HEARD_ODD with the name of the impossible value, and the value as text for people."""
    return [(HEARD_ODD, (what, odd_text(value)))]


def odd_text(value: object) -> str:
    """Return any value as one printable line of at most LONGEST_ODD_TEXT characters. Never raises."""
    try:
        text = ", ".join(map(odd_text, value[:MOST_ODD_VALUES])) if isinstance(value, (list, tuple)) else repr(value)
    except Exception:  # the repr of an unknown object, or an integer with more digits than Python prints
        text = f"a value of type {type(value).__name__}"
    return one_line(text)


def one_line(text: str) -> str:
    """Return a text as one printable line of at most LONGEST_ODD_TEXT characters."""
    line = "".join(c if c.isprintable() else "?" for c in text[: LONGEST_ODD_TEXT + 1])
    return line if len(line) <= LONGEST_ODD_TEXT else f"{line[: LONGEST_ODD_TEXT - 3]}..."

"""Setting: declares one setting, and checks if a value is allowed for it."""

from __future__ import annotations

from failstop.data import Data

MOST_SHOWN = 160
"""The most characters of a value that a message shows."""
LONGEST_TEXT = 255
UNITS = frozenset(
    (
        *("ns", "us", "ms", "s", "min", "h"),
        *("m", "mm", "cm", "m/s", "m/s2", "rad", "rad/s", "rad/s2", "deg/s", "degrees"),
        *("turns/s", "rps", "rpm", "Hz", "kHz"),
        *("V", "mV", "A", "%", "g", "C", "bytes", "kB", "MB", "GB", "baud"),
    )
)
"""The units that can follow a number in a sentence. A line is not broken between the number and its unit."""


class SettingError(ValueError):
    """A value is not allowed. The message names the key, the value and the allowed values."""


def shortened(text: str) -> str:
    """Replace unprintable characters, and shorten the text to at most MOST_SHOWN characters."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def shown(value: object) -> str:
    """Show a value of any type as a shortened text on one line."""
    try:
        return shortened(repr(value))
    except (ValueError, RecursionError):  # for example a number with thousands of digits, or lists nested very deeply
        return f"{type(value).__name__} that is too large to show"


class Setting(Data):
    """The declaration of one setting.

    A number has a range (both ends are allowed) or a list of allowed values. A text may have a list of allowed words,
    and with `or_folder` may also be the path of a folder. A text without a list may be empty only if its default is
    empty.
    """

    key: str
    default: float | str
    unit: str
    low: float | None
    high: float | None
    doc: str
    allowed: tuple[int, ...] | tuple[str, ...] = ()
    or_folder: bool = False
    off: int | None = None
    """A value outside of the range that is also allowed, and turns off what the setting is about. None: there is no
    such value."""

    def check(self, value: object, key: str = "") -> float | str:
        """Check a value, and return it in the type of this setting. Raises SettingError if the value is not allowed.
        `key`: the name of the setting in the error's message, by default the setting's own key."""
        if problem := self._problem(value):
            raise SettingError(f"{key or self.key} = {shown(value)}: {problem}")
        return type(self.default)(value)  # type: ignore[arg-type]

    def _problem(self, value: object) -> str:
        if self.allowed:
            fits = type(value) is type(self.default) and (value in self.allowed or self._is_folder(value))
            return "" if fits else f"it must be {self.range()}"
        if isinstance(self.default, str):
            fits = isinstance(value, str) and value.isprintable() and len(value) <= LONGEST_TEXT
            return "" if fits and (value or not self.default) else f"it must be a text of {self.range()}"
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return f"it must be a number, {self.range()}"
        if value == self.off:
            return ""
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            return f"it must be {self.range()}{self._meant(value)}"
        if isinstance(self.default, int) and value != int(value):
            return f"it must be a whole number, {self.range()}"
        return ""

    def _meant(self, value: float) -> str:
        """A question for a person who wrote volts where the unit is mV. Empty if the value can't be volts."""
        assert self.low is not None
        assert self.high is not None
        fits = self.unit == "mV" and self.low <= 1000 * value <= self.high
        return f": did you mean {round(1000 * value)}?" if fits else ""

    def _is_folder(self, value: object) -> bool:
        fits = self.or_folder and isinstance(value, str) and value.startswith("/")
        return fits and str(value).isprintable() and len(str(value)) <= LONGEST_TEXT

    def range(self) -> str:
        """The allowed values, in words."""
        if self.allowed:
            words = [f'"{word}"' if isinstance(word, str) else str(word) for word in self.allowed]
            return " or ".join((*words, "the path of a folder") if self.or_folder else words)
        if isinstance(self.default, str):
            return f"{1 if self.default else 0} to {LONGEST_TEXT} characters of one line"
        also = "" if self.off is None else f"{self.off:g}, or "
        return f"{also}{self.low:g} to {self.high:g} {self.unit}".rstrip()


def all_differ(values: dict[str, float | str]) -> None:
    """Raise SettingError if two of these settings have the same value."""
    seen: dict[float | str, str] = {}
    for key, value in values.items():
        if value in seen:
            raise SettingError(f"{key} = {value}: {seen[value]} is {value} too, but they must differ")
        seen[value] = key

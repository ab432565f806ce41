"""Settings: every setting declared once, with its default, unit, range and meaning.

The supervisor reads and checks them once (config.py) and hands them to the processes as `key=value` lines.
"""

from __future__ import annotations

from math import pi


class SettingError(ValueError):
    """A value is not allowed; the message names the key, the value and what is."""


class Setting:
    """One declaration. Numbers have a range (inclusive); texts have none."""

    __slots__ = ("default", "doc", "high", "key", "low", "unit")

    def __init__(
        self, key: str, default: float | str, unit: str, low: float | None, high: float | None, doc: str
    ) -> None:
        self.key = key
        self.default = default
        self.unit = unit
        self.low = low
        self.high = high
        self.doc = doc

    def check(self, value: object) -> float | str:
        """Return the value in its declared type, or raise SettingError."""
        if isinstance(self.default, str):
            if isinstance(value, str) and value and value.isprintable():
                return value
            raise SettingError(f"{self.key} = {value!r}: a text is expected")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SettingError(f"{self.key} = {value!r}: a number is expected, {self.range()}")
        if self.low is not None and self.high is not None and not self.low <= value <= self.high:
            raise SettingError(f"{self.key} = {value!r}: allowed is {self.range()}")
        if isinstance(self.default, int) and value != int(value):
            raise SettingError(f"{self.key} = {value!r}: a whole number is expected, {self.range()}")
        return type(self.default)(value)

    def range(self) -> str:
        """The allowed range in words."""
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip()


DECLARED = (
    Setting("device.path", "/dev/ttyACM0", "", None, None, "the motor board's port"),
    Setting("gate.period_s", 0.02, "s", 0.005, 0.05, "time between two decisions of the gate"),
    Setting("gate.command_timeout_s", 0.3, "s", 0.05, 2.0, "a command older than this moves nothing (the deadman)"),
    Setting("gate.refresh_s", 0.2, "s", 0.02, 1.0, "a motor frame goes out at least this often while enabled"),
    Setting("gate.lease_s", 0.06, "s", 0.02, 1.0, "gate or supervisor silent for this long: the port owner stops"),
    Setting("limits.vx_mps", 0.2, "m/s", 0.01, 3.0, "fastest forward and backward"),
    Setting("limits.vy_mps", 0.2, "m/s", 0.01, 3.0, "fastest sideways"),
    Setting("limits.wz_radps", 1.0, "rad/s", 0.01, 10.0, "fastest turn"),
    Setting("limits.acceleration_mps2", 0.5, "m/s2", 0.01, 20.0, "ramp of vx and vy"),
    Setting("limits.acceleration_radps2", 2.0, "rad/s2", 0.01, 100.0, "ramp of wz"),
    Setting("wheels.diameter_m", 0.08, "m", 0.02, 1.0, "wheel diameter"),
    Setting("wheels.wheelbase_m", 0.17706, "m", 0.01, 3.0, "distance of front and rear axle"),
    Setting("wheels.track_m", 0.17165, "m", 0.01, 3.0, "distance of left and right wheels"),
    Setting("pad.mode_button", 0x2000, "", 0, 0xFFFF, "the gamepad's MODE button, the only one that is no stop; a bit"),
    Setting("key.stop", 1, "", 1, 255, "the board key that stops"),
    Setting("restart.deaths", 5, "", 1, 100000, "after this many deaths within the window, stay stopped"),
    Setting("restart.window_s", 60.0, "s", 1.0, 3600.0, "the window in which deaths are counted"),
    Setting("restart.backoff_s", 0.1, "s", 0.001, 10.0, "wait before the second restart in the window; then doubled"),
)

BY_KEY = {setting.key: setting for setting in DECLARED}


class Settings:
    """A complete, checked set of values."""

    __slots__ = ("values",)

    def __init__(self, changed: dict[str, object] | None = None) -> None:
        """Raises SettingError for an unknown key, a wrong type, a value out of range, or values that contradict."""
        self.values: dict[str, float | str] = {setting.key: setting.default for setting in DECLARED}
        for key, value in (changed or {}).items():
            if key not in BY_KEY:
                raise SettingError(f"{key}: no such setting; `failstop config` lists them all")
            self.values[key] = BY_KEY[key].check(value)
        self._cross_check()

    def _cross_check(self) -> None:
        for longer, shorter in (
            ("gate.command_timeout_s", "gate.lease_s"),
            ("gate.lease_s", "gate.period_s"),
            ("gate.command_timeout_s", "gate.period_s"),
        ):
            if self[longer] <= self[shorter]:
                raise SettingError(f"{longer} = {self[longer]:g} s must be longer than {shorter} = {self[shorter]:g} s")

    def __getitem__(self, key: str) -> float:
        """A number, in the unit its name ends in."""
        value = self.values[key]
        if isinstance(value, str):
            raise TypeError(f"{key} is a text")
        return value

    def text(self, key: str) -> str:
        """A text."""
        return str(self.values[key])

    def ns(self, key: str) -> int:
        """A time in seconds, as nanoseconds."""
        return round(self[key] * 1e9)

    def max_wheel_rps(self) -> float:
        """The fastest that any wheel can turn within the limits, in revolutions per second."""
        lever = (self["wheels.wheelbase_m"] + self["wheels.track_m"]) / 2
        rim_mps = self["limits.vx_mps"] + self["limits.vy_mps"] + self["limits.wz_radps"] * lever
        return rim_mps / (pi * self["wheels.diameter_m"])

    def lines(self) -> str:
        """The values as `key=value` lines, for from_lines."""
        return "\n".join(f"{key}={value}" for key, value in self.values.items())

    @classmethod
    def from_lines(cls, text: str) -> Settings:
        """The inverse of lines()."""
        changed: dict[str, object] = {}
        for line in text.splitlines():
            key, value = line.split("=", 1)
            changed[key] = value if isinstance(BY_KEY[key].default, str) else type(BY_KEY[key].default)(value)
        return cls(changed)

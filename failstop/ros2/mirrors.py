"""Mirrors: parameters of an earlier driver, which show the service's settings but can't change them. Pure.

A setting can be changed only in the service's settings file. The bridge ignores values from launch and YAML files, and
logs a warning if such a value differs from the setting.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

from failstop.api.snapshot import Imu

ParameterValue = bool | int | float | str | list[float]
RobotSettings = Mapping[str, float | str]

GYRO_NOISE_RADPS = round(float(Imu._field_defaults["rate_variance"]) ** 0.5, 9)
FIXED = "it is a fact of the robot, not a setting"


class Mirror(NamedTuple):
    """One parameter: its name, the keys of the settings that it shows, and the function that computes its value. A
    parameter without keys has a fixed value."""

    name: str
    keys: tuple[str, ...]
    show: Callable[[RobotSettings], ParameterValue]


def _number(key: str) -> Callable[[RobotSettings], ParameterValue]:
    return lambda settings: float(settings[key])


def _xyz(key: str) -> Callable[[RobotSettings], ParameterValue]:
    return lambda settings: [float(settings[key.format(axis)]) for axis in "xyz"]


def _same(name: str, key: str) -> Mirror:
    return Mirror(name, (key,), _number(key))


def command_timeout_s(settings: RobotSettings) -> float:
    """How long a command of cmd_vel is used, s."""
    return float(settings["sources.cmd_vel.timeout_s"])


TABLE = (
    Mirror("device", ("device.path",), lambda settings: str(settings["device.path"])),
    _same("gyro_calib_seconds", "imu.calibration_s"),
    _same("gyro_calib_max_std_dps", "imu.calibration_std_dps"),
    Mirror("estop_key", ("key.stop",), lambda settings: int(settings["key.stop"])),
    Mirror("control_rate_hz", ("gate.period_s",), lambda settings: 1 / float(settings["gate.period_s"])),
    Mirror(
        "max_linear",
        ("limits.vx_mps", "limits.vy_mps"),
        lambda settings: max(float(settings["limits.vx_mps"]), float(settings["limits.vy_mps"])),
    ),
    _same("max_angular", "limits.wz_radps"),
    _same("max_accel_linear", "limits.acceleration_mps2"),
    _same("max_accel_angular", "limits.acceleration_radps2"),
    Mirror("cmd_timeout", ("sources.cmd_vel.timeout_s",), command_timeout_s),
    Mirror(
        "scan_timeout",
        ("scan.timeout_s", "scan.gate"),
        lambda settings: float(settings["scan.timeout_s"]) if settings["scan.gate"] == "on" else 0.0,
    ),
    Mirror("accel_offset_g", tuple(f"imu.offset_{axis}_g" for axis in "xyz"), _xyz("imu.offset_{}_g")),
    Mirror("accel_scale", tuple(f"imu.scale_{axis}" for axis in "xyz"), _xyz("imu.scale_{}")),
    _same("gyro_bias_tau_s", "imu.tracking_tau_s"),
    _same("gyro_bias_settle_s", "imu.tracking_rest_s"),
    _same("gyro_bias_max_dev_dps", "imu.tracking_band_dps"),
    Mirror("gyro_noise_rad_s", (), lambda settings: GYRO_NOISE_RADPS),
    _same("odom_linear_std", "odometry.twist_std_mps"),
    _same("odom_angular_std", "odometry.twist_std_radps"),
    _same("odom_scale_x", "odometry.forward_scale"),
    _same("odom_scale_y", "odometry.sideways_scale"),
    Mirror("pad_sounds", ("buzzer.tones",), lambda settings: settings["buzzer.tones"] == "on"),
    Mirror("drive_pan", ("arm.drive_pan",), lambda settings: int(settings["arm.drive_pan"])),
)
MIRROR_BY_NAME = {mirror.name: mirror for mirror in TABLE}


def values(settings: RobotSettings) -> dict[str, ParameterValue]:
    """The values of all these parameters."""
    return {mirror.name: mirror.show(settings) for mirror in TABLE}


def refusal(name: str) -> str:
    """Why the bridge refuses to set a parameter, and what to change instead."""
    mirror = MIRROR_BY_NAME.get(name)
    if mirror is None:
        return f"{name} is read once, at the start of the bridge: set it in its launch file or YAML"
    if not mirror.keys:
        return f"{name} is read-only: {FIXED}"
    keys = " and ".join(mirror.keys)
    return f"{name} shows failstop's settings: change {keys} in failstop's TOML file and restart the service"


def differing(given: Mapping[str, object], shown: Mapping[str, ParameterValue]) -> list[str]:
    """A warning for each given value that differs from the settings."""
    lines = []
    for name, value in given.items():
        if name in shown and not _equal(value, shown[name]):
            keys = " and ".join(MIRROR_BY_NAME[name].keys)
            where = f"change {keys} in failstop's TOML file, or remove it here" if keys else f"remove it: {FIXED}"
            lines.append(
                f"parameter {name} = {_shown(value)} has no effect, because {_shown(shown[name])} is in force: {where}"
            )
    return lines


def _equal(given: object, shown: ParameterValue) -> bool:
    if isinstance(shown, list):
        return isinstance(given, (list, tuple)) and len(given) == len(shown) and all(map(_equal, given, shown))
    if isinstance(given, (int, float)) and isinstance(shown, (int, float)):
        return abs(given - shown) <= 1e-9 * max(1.0, abs(shown))
    if isinstance(given, str) and isinstance(shown, str) and "/" in given + shown:
        return os.path.normpath(given) == os.path.normpath(shown)
    return given == shown


def _shown(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)

"""MotorCalibration: a row of a calibration file."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass
class MotorCalibration:
    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

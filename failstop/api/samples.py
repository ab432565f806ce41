"""What the board reports, sample by sample with the time of each, for programs that must not miss one.

for sample in robot.samples():
    if isinstance(sample, ImuSample):
        print(sample.t_ns, sample.rate_radps)

The state has the newest value of each alone. The times here are CLOCK_MONOTONIC in ns, of the read that brought the
sample: what one read brought has one time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from failstop.procs.telemetry.imu import RATE_VARIANCE
from failstop.procs.telemetry.odometry import POSE_VARIANCE
from failstop.shm import box, records
from failstop.shm.segment import Segment


class ImuSample(NamedTuple):
    """One IMU sample, x forward, y left, z up; the rate less its bias."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    acceleration_mps2: tuple[float, ...]
    """m/s2."""
    rate_radps: tuple[float, ...]
    """rad/s."""
    rate_variance: float = RATE_VARIANCE
    """Of each axis, in (rad/s)2."""


class BatterySample(NamedTuple):
    """One reading of the battery."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    battery_v: float
    """V."""
    plugged: str
    """unknown, plugged or unplugged."""


class PadSample(NamedTuple):
    """One frame of the gamepad: a bit a button, the hat, raw axes -128 to 127."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    buttons: int
    """A bit a button."""
    hat: int
    """As the board gives it."""
    axes: tuple[int, ...]
    """lx, ly, rx, ry."""
    mode: str
    """locked, drive or joint."""


class OdometrySample(NamedTuple):
    """The pose since the start and the twist in the robot's frame, integrated from what was commanded."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    x_m: float
    """m, forward at the start."""
    y_m: float
    """m, to the left at the start."""
    th_rad: float
    """rad counter-clockwise."""
    vx_mps: float
    """m/s forward."""
    vy_mps: float
    """m/s to the left."""
    wz_radps: float
    """rad/s counter-clockwise."""
    twist_std_mps: float
    """Standard deviation of vx and vy, m/s."""
    twist_std_radps: float
    """Standard deviation of wz, rad/s."""
    pose_variance: float = POSE_VARIANCE
    """m2 and rad2: not to be trusted."""


Sample = ImuSample | BatterySample | PadSample | OdometrySample


class SampleReader:
    """The samples of a run from now on; needs no permission and no client slot. Not thread-safe."""

    def __init__(self, telemetry: Segment) -> None:
        self._board = telemetry.ring_reader("box")
        self._odometry = telemetry.latest_reader("odometry")
        self._odometry_seq = 0

    def read(self) -> list[Sample]:
        """The samples since the last call, in order, and the newest odometry, if it is new."""
        found: list[Sample] = []
        while entry := self._board.next():
            kind, values = box.unpack_board(entry[2])
            if make := _MAKERS.get(kind):
                found.append(make(entry[1], *values))
        news = self._odometry.read()
        if news and news[0] != self._odometry_seq:
            self._odometry_seq = news[0]
            found.append(OdometrySample(news[1], *records.ODOMETRY.unpack(news[2])))
        return found


_MAKERS: dict[int, Callable[..., Sample]] = {
    box.IMU: lambda t_ns, *values: ImuSample(t_ns, values[:3], values[3:]),
    box.BATTERY: lambda t_ns, millivolts, plugged: BatterySample(t_ns, millivolts / 1000, records.PLUGGED[plugged]),
    box.PAD: lambda t_ns, buttons, hat, *rest: PadSample(t_ns, buttons, hat, rest[:-1], records.PAD_MODES[rest[-1]]),
}
"""Of the box's records, those that are samples: what the arm's servos answer is told in State.arm."""

__all__ = ["BatterySample", "ImuSample", "OdometrySample", "PadSample", "Sample", "SampleReader"]

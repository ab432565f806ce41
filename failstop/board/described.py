"""Described: makes a Board from a Wire. Such a board has no gamepad and no keys."""

from __future__ import annotations

from itertools import islice
from math import pi

from failstop.board import plausible
from failstop.board.checks import number
from failstop.board.interface import (
    BY_ANSWER,
    BY_ECHO,
    BY_IMU,
    BY_WHEELS,
    HEARD_FIRMWARE,
    HEARD_HEALTH,
    HEARD_OBEYED,
    HEARD_PONG,
    HEARD_RESTARTED,
    HEARD_SERVO,
    HEARD_WHEELS,
    NO_WHEEL_REPORTS,
    UNKNOWN_EVERY_NS,
    Board,
    Hearing,
    WheelReports,
)
from failstop.board.servos import ServoAnswer
from failstop.board.steered import SteeringMixin
from failstop.board.wire import ECHOED, OBSERVED, Battery, Firmware, Health, Imu, Obeyed, Restarted, Sample, Wheels

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.interface import Said, SteeringFrames
    from failstop.board.wire import Wire

MOST_SAMPLES = 10_000
"""The most samples that one feed() takes from the board's reader. A faulty reader that returned samples without end
would otherwise hang telemetry."""
MOST_VALUE = 0x7FFFFFFF
MOST_LOAD = 1.27
"""The largest load of a servo that counts as possible. A load of 1.0 is the most that the servo can give, and Feetech's
servos report up to 1.023. The limit is 1.27 because a load is stored as percent in one signed byte."""
SLOWEST_MPS = 0.04
"""A wheel that turns at this speed, in m/s at its rim, must still be seen to turn by its positions."""
MOST_APART_NS = 400_000_000
"""Reports this far apart, in ns, are compared, however much one count of their positions is."""
_ROUNDING = 1.0 + 2.0**-40
_GRAVITY = 9.80665


class Samples(Hearing):
    """Decodes the board's bytes with the reader of its description."""

    __slots__ = ("_reader", "_wire")

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self._reader = wire.reader()

    def feed(self, chunk: bytes) -> list[Said]:
        """Return all reports that these bytes complete. After a report that answers pings comes a HEARD_PONG with these
        pings."""
        found: list[Said] = []
        try:
            for sample in islice(self._reader.feed(chunk), MOST_SAMPLES):
                found += _said(sample)
                questions = enumerate(self._wire.questions)
                if answers := tuple([index for index, question in questions if question.answered_by(sample)]):
                    found.append((HEARD_PONG, answers))
        except Exception as error:  # an error in the reader of your own board must not end the process
            found += plausible.odd("reader", error)
            self.reset()
        return found

    def reset(self) -> None:
        """Start again with a new reader, which has no incomplete sample."""
        self._reader = self._wire.reader()


def _said(sample: Sample) -> list[Said]:
    try:
        return _plausible(sample)
    except plausible.IMPOSSIBLE:
        what = type(sample).__name__.lower()
        return plausible.odd(what, tuple(vars(sample).values()))


def _plausible(sample: Sample) -> list[Said]:
    """Return the reports in a sample. Raises one of plausible.IMPOSSIBLE for an impossible value."""
    if isinstance(sample, Wheels):
        return [(HEARD_WHEELS, (_wheels(sample.speeds, 0), _wheels(sample.positions, 0)))]
    if isinstance(sample, Obeyed):
        return [(HEARD_OBEYED, _wheels(sample.speeds, 1))]
    if isinstance(sample, Battery):
        return plausible.battery_said(sample.volts)
    if isinstance(sample, ServoAnswer):
        servo, what = plausible.whole_number(sample.servo, 0, 255), plausible.whole_number(sample.what, 0, 255)
        return [(HEARD_SERVO, (servo, what, plausible.whole_number(sample.value, -MOST_VALUE, MOST_VALUE)))]
    if isinstance(sample, Restarted):
        return [(HEARD_RESTARTED, (plausible.one_line(str(sample.text)),))]
    if isinstance(sample, Firmware):
        return [(HEARD_FIRMWARE, (sample.name,))]
    if isinstance(sample, Health):
        return [(HEARD_HEALTH, tuple(map(_health, islice(sample.rows, plausible.MOST_HEALTH_ROWS))))]
    if isinstance(sample, Imu):
        accel = [value / _GRAVITY for value in sample.accel]
        return plausible.imu_said((*accel, *(value * 180 / pi for value in sample.gyro)))
    return []


def _reports(wire: Wire, per_rps: float, diameter_m: float) -> WheelReports:
    if OBSERVED not in wire.proofs:
        return NO_WHEEL_REPORTS
    told = wire.reports
    if told is None:
        return WheelReports(UNKNOWN_EVERY_NS, per_rps, 0.0, 0.0, holds_speed=False, own_scale=False)
    speed = told.speed_per_rps(per_rps, diameter_m) if told.speed_per_rps else 0.0
    position = told.position_per_turn(per_rps, diameter_m) if told.position_per_turn else 0.0
    step_m = told.position_step / position * pi * diameter_m if position else 0.0
    apart_ns = min(MOST_APART_NS, round(step_m / SLOWEST_MPS * 1e9))
    scale = (told.holds_speed, told.own_scale, told.position_step, apart_ns)
    return WheelReports(told.every_ns, speed, position, told.wraps, *scale)


def _wheels(values: Sequence[float], least: int) -> tuple[float, ...]:
    return plausible.finite_numbers(values, plausible.MOST_COUNT, least, plausible.MOST_REPORTED_WHEELS)


def _health(row: Sequence[float]) -> tuple[int, float, int, int]:
    servo, at_c = plausible.whole_number(row[0], 0, 255), plausible.whole_number(row[2], 0, 255)
    wrong = plausible.whole_number(row[3], 0, 255) if len(row) > 3 else 0
    return servo, plausible.finite(row[1], MOST_LOAD), at_c, wrong


class Described(Board):
    """A board that is described by a Wire. The Wire's `motion` has the number of speeds in a frame, and their unit."""

    __slots__ = (
        "_motion", "_wire", "acknowledged_by", "after_ns", "arm", "arming", "burst", "commanders", "echo_ns",
        "fades_ns", "first_stop", "idle_ns", "most_rps", "name", "observed_by", "other_bauds", "per_rps",
        "ping_ns", "pings", "port",
        "refresh", "repeats_ns", "reports", "scale_assumed", "silent_ns", "step_rps", "stop", "usb", "wheels",
    )  # fmt: skip

    usb_alone = False

    def __init__(self, wire: Wire, per_rps: float, diameter_m: float, baud: int = 0) -> None:
        """`per_rps` is how many of the board's speed units make one wheel turn per second, `diameter_m` is the diameter
        of a wheel, and `baud` is the baud rate (0 means the usual rate)."""
        (write,) = wire.stop.writes
        self._wire, self._motion, self.per_rps = wire, wire.motion, per_rps
        self.scale_assumed = False
        self.name, self.port = wire.name, wire.port.at(baud) if baud else wire.port
        self.other_bauds = tuple(each for each in (wire.port.baud, *wire.other_bauds) if each != self.port.baud)
        # Never 0, so that frames wait until the line has sent those before them. An adapter takes bytes faster than its
        # line sends them and tells nobody how many are left, and a stop would have to wait for all of them.
        self.idle_ns = max(wire.stop.after_ns, wire.pace.idle_ns, 1)
        self.after_ns = wire.stop.after_ns
        self.repeats_ns = tuple(row[1:] for row in wire.stop.repeats_ns)
        self.stop = wire.motion.rest
        self.burst = self.first_stop = self.refresh = write.data
        self.pings = tuple(question.ask for question in wire.questions)
        self.ping_ns, self.echo_ns = wire.ping_ns, wire.echo_ns
        self.silent_ns = wire.silent_ns
        self.arming = wire.watchdog.arm(wire.watchdog.set_ns) if wire.watchdog.arm and wire.watchdog.set_ns else b""
        self.fades_ns = wire.watchdog.acts_ns if wire.echo_ns else 0
        self.acknowledged_by = BY_ECHO if ECHOED in wire.proofs else BY_ANSWER if wire.questions else ""
        self.observed_by = BY_WHEELS if OBSERVED in wire.proofs else BY_IMU
        self.reports = _reports(wire, per_rps, diameter_m)
        self.usb, self.commanders = wire.usb, wire.commanders
        self.arm = wire.arm(self.port) if wire.arm else None
        self.wheels = wire.motion.wheels
        self.most_rps = min(wire.motion.limit, wire.motion.apart / 2) / per_rps
        self.step_rps = wire.motion.step / per_rps

    def hearing(self) -> Hearing:
        """Return a new decoder. It uses the reader that the description names."""
        return Samples(self._wire)

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """Return the frame that sets the speeds of all wheels."""
        limit = self._limit(max_rps)
        every = [number("speed of a wheel", speed, -max_rps, max_rps, "rps") for speed in rps]
        return self._motion.frame(tuple([max(-limit, min(speed * self.per_rps, limit)) for speed in every]), limit)

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Return the reason to refuse a motion frame, or "" to accept it. The description's own check decides. It gets
        the limit in the board's unit."""
        return self._motion.check(frame, self._limit(max_rps))

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """Return the speeds of all wheels in a motion frame, in turns per second. None for other bytes."""
        found = self._motion.speeds(frame)
        return None if found is None else tuple([speed / self.per_rps for speed in found])

    def commanded(self, frame: bytes) -> Sequence[float] | None:
        """Return the speeds of a motion frame or a stop, for handled.Echo. None if the board does not report the
        command that it obeys. Also None if the board has pings, because Echo is only for boards without pings."""
        if not self.echo_ns or self.pings:
            return None
        return (0.0,) * self.wheels if frame == self.burst else self._motion.speeds(frame)

    def marked(self, frame: bytes, turn: int) -> bytes:
        """Return the frame to write when the same motion is sent for the `turn`th time. Motion.marked in the
        description makes some of these frames slightly slower. Without Motion.marked, the frame is returned
        unchanged."""
        return self._motion.marked(frame, turn) if self._motion.marked else frame

    def _limit(self, max_rps: float) -> float:
        return min(max_rps * self.per_rps * _ROUNDING, self._motion.limit)

    def buzzer(self, freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
        """Return no bytes, because a Wire describes no buzzer."""
        return b""

    def check_aux(self, frame: bytes) -> str:
        """Return the reason to refuse an extra frame, for example one for a light, or "" to accept it. The
        description's function `aux` decides. A motion frame is always refused. If there is no `aux`, every frame is
        refused."""
        if not self._wire.aux or self._motion.speeds(frame) is not None:
            return "this board takes nothing but motion"
        try:
            return self._wire.aux(frame)
        except Exception as error:  # an error in the check of your own board must not end the process
            return f"its check failed: {type(error).__name__}"


class SteeredBoard(SteeringMixin, Described):
    """A board with steered wheels. A Wire describes it."""

    __slots__ = ("_steering",)

    def __init__(self, wire: Wire, per_rps: float, diameter_m: float, baud: int, steering: SteeringFrames) -> None:
        super().__init__(wire, per_rps, diameter_m, baud)
        self._steering = steering

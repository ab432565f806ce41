"""Snapshot: the state of a service as named values. Times are in s, lengths in m, angles in rad, voltages in V."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any, Literal, NamedTuple

from failstop.messages import box, records
from failstop.policy.causes import Cause
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.proofs import LINK_SILENT, LINK_UNHEARD
from failstop.policy.settings import FIRST_SOURCE

PadMode = Literal["locked", "drive", "joint"]


class Block(enum.Enum):
    """Why the wheels may not turn; the first reason that holds is given."""

    LATCHED = "latched"
    """A stop is latched: `State.cause`. It needs a reset."""
    DISABLED = "disabled"
    """Motion was not enabled since the start, the last stop or the last disable."""
    HELD = "let go first"
    """The source has commanded a velocity since before motion was enabled. It counts after a zero or a pause."""
    NO_COMMAND = "no command"
    """No source has a command that is younger than its timeout."""
    NO_SCAN = "no scan"
    """The obstacle sensor is silent; without it only a person may drive."""

    @classmethod
    def of(cls, text: str | None) -> Block | None:
        """The block for the gate's text (`State.blocked`)."""
        told = {
            box.DISABLED: cls.DISABLED,
            box.HELD: cls.HELD,
            box.NO_COMMAND: cls.NO_COMMAND,
            box.NO_SCAN: cls.NO_SCAN,
        }
        return None if text is None else told.get(text, cls.LATCHED)


class Velocity(NamedTuple):
    """The velocity of the robot in its own frame."""

    vx_mps: float
    """m/s forward."""
    vy_mps: float
    """m/s to the left."""
    wz_radps: float
    """rad/s counter-clockwise, seen from above."""


class Wheels(tuple[float, ...]):
    """The speed of each wheel in rad/s. Positive is forward, or for three omni wheels counter-clockwise."""

    @property
    def names(self) -> tuple[str, ...]:
        """front_left, rear_left, front_right, rear_right; or left, rear, right; or left, right."""
        return tuple(name.replace(" ", "_") for name in WHEEL_NAMES[len(self)])

    def __getattr__(self, name: str) -> float:
        if name in self.names:
            return self[self.names.index(name)]
        raise AttributeError(f"no wheel {name!r}: this robot has {', '.join(self.names)}", name=name, obj=self)


@dataclasses.dataclass(frozen=True)
class Turning:
    """What is known about the wheels now, from the board's reports or from the IMU."""

    does: Literal["unknown", "still", "turning"] = "unknown"
    """turning; still; unknown: nothing has been read, or not for half a second."""
    by: Literal["", "IMU", "wheels"] = ""
    """What observed it: wheels (the board's reports about them), or IMU, which only feels that the robot moves, or is
    being moved."""
    unexpected: bool = False
    """The wheels turn although they were told zero for longer than the setting still.after_s allows."""
    since_s: float | None = None
    """How long it has been so, s; None: not known."""
    age_s: float | None = None
    """Age of the newest reading, s; None if there was none."""
    last: Literal["unknown", "still", "turning"] = "unknown"
    """What the newest reading said, however old it is."""
    speeds_radps: Wheels | None = None
    """Measured speed of each wheel, rad/s, positive forward, by the names of `Wheels`; None if the board reports
    none."""
    turned_rad: Wheels | None = None
    """How far each wheel has turned since the first report, rad, positive forward: counted by the board, or added up
    from its speeds. None if the board reports none."""


OLD_S = 10.0
"""A reading of this age says nothing about now."""


@dataclasses.dataclass(frozen=True)
class Ages:
    """Ages of the newest readings, s; None if there was none in this run."""

    board_s: float | None = None
    """Since the board said anything, of any kind."""
    battery_s: float | None = None
    """Age of `State.battery_v`."""
    imu_s: float | None = None
    """Age of `State.imu`."""
    odometry_s: float | None = None
    """Age of `State.odometry`."""
    servos_s: float | None = None
    """Age of `State.servos`."""


@dataclasses.dataclass(frozen=True)
class Scale:
    """Whether the wheels turn as fast as commanded (setting board.per_rps)."""

    capped: str = ""
    """Nobody has confirmed board.per_rps, so speeds are capped: a text with the remedy; empty if it is confirmed."""
    wheels: float | None = None
    """Measured wheel speed divided by the commanded one, from reports in a unit of their own; None: not known."""
    turn: float | None = None
    """Measured turn rate of the robot divided by the commanded one, from the gyro; None: not known."""
    wrong: tuple[str, ...] = ()
    """What differs, in words, with the setting to look at."""
    remarks: tuple[str, ...] = ()
    """What differs by less, so that a slope, a load, the battery or skidding wheels may explain it."""


@dataclasses.dataclass(frozen=True)
class Stop:
    """The last stop, and its three proofs; each is None until it is known."""

    cause: Cause
    """Why."""
    reason: str
    """The text of `cause`."""
    t: float
    """Unix time, s."""
    noticed_by: str
    """The process that noticed the cause."""
    written_by: str
    """The process that wrote the stop."""
    written_s: float | None
    """Written: from noticing the cause until the kernel had the bytes, s. None if they could not be written."""
    acknowledged_s: float | None
    """Acknowledged: from noticing the cause until the board answered a ping written after the stop, or reported that it
    obeys it, s."""
    observed_s: float | None
    """Observed: from noticing the cause until the wheels were seen still, s; 0 if they were not seen moving before the
    stop either."""
    epoch: int = 0
    """The epoch raised for it. It also answered anyone who asked for a stop in an earlier epoch."""
    sent: bool = True
    """False if its bytes were found to be still in the kernel, because the board takes none."""
    acknowledged_by: str = "answer"
    """How the board acknowledges: answer (to a ping), echo (of what it obeys); empty: not at all."""
    observed_by: str = "IMU"
    """Source of `observed_s`: IMU, or wheels (the board's own reports about them); empty if the robot has no IMU."""
    noticed_ns: int = 0
    """When the cause was noticed (CLOCK_MONOTONIC, ns), independent of the wall clock."""
    believed: bool = True
    """False until the device that took its bytes has answered as the board does."""


@dataclasses.dataclass(frozen=True)
class Process:
    """One process of the service."""

    pid: int
    """0 while no such process exists."""
    state: str
    """starting, running, hanging, suspended (by a signal), fenced (for hanging), dead, waiting, down, or stopping."""
    age_s: float
    """Since its last heartbeat, s; before its first one since the begin of the run."""
    restarts: int
    """How often it was restarted in this run."""
    last_exit: str | None
    """How the process before it died."""
    worst_s: float
    """The longest time between two turns of its loop since its start, s."""
    realtime: bool
    """It has real-time rights (SCHED_FIFO)."""
    memory_locked: bool
    """Its memory can't be swapped out."""
    early_news: bool = True
    """True if the kernel reports a death to this process before it frees the dead process's memory."""
    killed: bool = False
    """The process before it was killed by a signal."""
    starts_in_s: float | None = None
    """Time until it is started again, s; None if it is running, or needs a reset first."""


@dataclasses.dataclass(frozen=True)
class Device:
    """The port of the board."""

    path: str
    """Path of its file, as the settings or `--device` name it."""
    state: Literal["closed", "open", "lost"]
    """closed, open, or lost (unplugged)."""
    link: Literal["unproven", "alive", "deaf", "silent", "unheard", "unasked"]
    """alive: it answers; unproven: it has not answered yet; deaf: it does not hear; silent: it says nothing any more;
    unheard: it has not answered since a replug; unasked: it can't answer, by design."""
    watchdog_s: float = 0.0
    """How long after the last frame the board's own watchdog acts, s; 0 if it has none, or it is not known."""
    watchdog_does: str = ""
    """What that watchdog does: zero (it stops the wheels), coast (they roll on without current), or disarm."""
    imu: bool = True
    """False: the robot has no IMU (setting board.imu)."""
    unheeded_s: float | None = None
    """How long the board has reported that it obeys zero speed while motion is commanded, s; None if it has not."""


@dataclasses.dataclass(frozen=True)
class Client:
    """A program that holds a client slot."""

    slot: int
    """0 to 7."""
    name: str
    """Its name, as it reports it."""
    pid: int
    """Its pid, as it reports it."""
    driving: bool
    """Its command moves the wheels now."""
    sees: str = ""
    """A line on what it sees, as it reports it (`Robot.say`)."""
    wrong: str = ""
    """A line on what is wrong, as it reports it."""
    said_s: float | None = None
    """How long ago it reported that, s; None: never."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A source with a fresh command."""

    source: str
    """Its name in the settings, or `gamepad`."""
    priority: int
    """The highest drives."""
    who: str
    """The program that commands as this source: name and pid."""
    state: Literal["drives", "waits", "held", "silent"]
    """drives; waits: a higher one drives; held: it commanded before motion was enabled and must send zero or pause
    first; silent: it drove, and stopped sending commands while the wheels turned."""

    def __str__(self) -> str:
        """The program, and its source unless that is the one that every program has by default."""
        return self.who if self.source == FIRST_SOURCE else f"{self.who} as {self.source}"


@dataclasses.dataclass(frozen=True)
class Starved:
    """The longest silence in ten minutes that the machine explains, while motion was disabled, so that nothing was
    stopped for it."""

    longest_s: float
    """How long, s."""
    process: str
    """The process that the machine did not run."""

    def __str__(self) -> str:
        return f"the computer is too busy: {self.process} did not run for {self.longest_s * 1e3:.0f} ms"


@dataclasses.dataclass(frozen=True)
class GyroBias:
    """The gyro's reading while the robot stands still."""

    bias_radps: tuple[float, float, float]
    """rad/s, x forward, y left, z up."""
    tracking: bool
    """True if it follows the reading now."""
    calibrated: bool
    """The robot stood still long enough at the start."""


class Imu(NamedTuple):
    """One sample of the IMU: x forward, y left, z up."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    acceleration_mps2: tuple[float, ...]
    """m/s2."""
    rate_radps: tuple[float, ...]
    """rad/s, less the bias."""
    rate_variance: float = records.RATE_VARIANCE
    """Variance of each axis of the rate, (rad/s)2."""


DEAD_RECKONING = (records.POSE_VARIANCE, 0.0, 0.0, records.POSE_VARIANCE, 0.0, records.POSE_VARIANCE)


class Odometry(NamedTuple):
    """Pose since the start and velocity, from the wheels if the board reports them, else from the commands."""

    t_ns: int
    """CLOCK_MONOTONIC of the pose, ns: the time of the wheels' newest report, if they count."""
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
    """Standard deviation of vx and vy, m/s, by the settings."""
    twist_std_radps: float
    """Standard deviation of wz, rad/s, by the settings."""
    source: Literal["commands", "wheels"] = "commands"
    """wheels: as far as the board reports that they have turned. commands: as far as they were told to turn, whatever
    they did, because the board has reported nothing about them."""
    pose_covariance: tuple[float, ...] = DEAD_RECKONING
    """Covariance of x, y (m2) and th (rad2): xx, xy, x th, yy, y th, th th. From wheels it grows with the distance;
    from commands it is so large that nobody trusts the pose."""

    @property
    def pose_variance(self) -> float:
        """The largest variance of x, y (m2) and th (rad2)."""
        return max(self.pose_covariance[0], self.pose_covariance[3], self.pose_covariance[5])


class Pad(NamedTuple):
    """One frame of the gamepad."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    buttons: int
    """One bit per button."""
    hat: int
    """As the board reports it."""
    axes: tuple[int, ...]
    """lx, ly, rx, ry, -128 to 127."""
    mode: PadMode
    """What the gamepad moves."""


Sample = Imu | Pad | Odometry
"""A sample, as `Robot.samples` gives it."""


@dataclasses.dataclass(frozen=True)
class JointState:
    """One joint of the arm."""

    servo: int
    """The id of its servo on the bus."""
    angle_rad: float | None
    """Measured, rad; None before a reading."""
    pulses: int | None
    """Its position in the servo's pulses."""
    age_s: float | None
    """Since it was read, s."""
    commanded_rad: float | None
    """Where it was sent, rad; None while its position is not known."""
    torque: bool | None
    """True if it holds; None: not known yet."""
    temperature_c: int | None
    """Temperature of the servo, degrees Celsius."""
    supply_v: float | None
    """Supply voltage of the servo, V."""

    @property
    def at_rad(self) -> float | None:
        """Where it is as far as is known, rad: where it was sent (no servo is asked while it moves), or where it was
        read to be."""
        return self.angle_rad if self.commanded_rad is None else self.commanded_rad


@dataclasses.dataclass(frozen=True)
class ArmState:
    """The arm."""

    mode: str
    """trajectory, follow, jog, or empty."""
    phase: str
    """How far a trajectory is."""
    moving: bool
    """It moves now."""
    by: str
    """The program that moves it; empty if none does."""
    closed: str
    """Why it takes no goal; empty if it takes one."""
    refused: str
    """Why the last goal of a stream was not taken; empty if it was."""
    released: bool
    """Its torque is off."""
    silent: tuple[int, ...]
    """Servos that do not answer."""
    wrong: tuple[str, ...]
    """Its faults, in words."""
    pose: str
    """drive, tuck, or empty."""
    auto_tuck_s: float | None
    """Time until it tucks itself, s; None if it does not."""
    pad_joint: str | None
    """The joint that the gamepad turns."""
    joints: dict[str, JointState]
    """The joints by name."""


@dataclasses.dataclass(frozen=True)
class State:
    """One consistent snapshot: the gate's decision is one record, read whole."""

    name: str
    """Name of the service."""
    enabled: bool
    """Motion is enabled."""
    estop: str | None
    """The text of `cause`."""
    cause: Cause | None
    """The cause of the latched stop: the first since the last reset; None if nothing is latched."""
    blocked: str | None
    """Why the wheels may not turn, in the gate's words; None when they may. Programs compare `block`."""
    body_vel: Velocity
    """The velocity that the gate commands."""
    wheels_radps: Wheels
    """The speed that the gate commands for each wheel."""
    epoch: int
    """Raised by every stop."""
    waiting_for: str | None
    """The part that is not up yet; motion can't be enabled until it is."""
    device: Device
    """The port of the board."""
    processes: dict[str, Process]
    """The processes by name."""
    starved: Starved | None
    """None if the machine has run every process in time for ten minutes."""
    clients: tuple[Client, ...]
    """The holders of the client slots."""
    sources: tuple[Source, ...]
    """The source that drives and those that wait, highest priority first."""
    scan_age_s: float | None
    """Since the obstacle sensor delivered last, s; None: never."""
    last_stop: Stop | None
    """None if there was no stop in this run."""
    imu: Imu | None
    """None before the first sample."""
    gyro_bias: GyroBias | None
    """None before it is known."""
    odometry: Odometry | None
    """None before the first."""
    pad_mode: PadMode | None
    """None: no gamepad frame yet."""
    battery_v: float | None
    """V; None before the first reading, and while the board reports no battery or an impossible voltage."""
    plugged: Literal["unknown", "plugged", "unplugged"]
    """Whether a charger is plugged in, judged from the voltage's steps."""
    age_s: float
    """Age of the gate's record, s: it publishes every 0.08 s at least."""
    speed_limit: float = 1.0
    """The share of the settings' speeds that drivers may use (`Robot.limit_speed`)."""
    attended_by: tuple[str, ...] | None = None
    """The operators who are present; None if none is needed (setting attend.required)."""
    arm: ArmState | None = None
    """None without an arm in the settings, and while a service starts, until its gate has reported the arm."""
    unmet: str = ""
    """Why an interlock does not hold, in the words of its refusal; empty if all declared ones hold."""
    starved_times: int = 0
    """How often in this run the machine explained a silence as in `starved`."""
    lease_s: float = 0.06
    """Longest silence of gate or supervisor while wheels turn, s (gate.lease_s; longer without real-time rights)."""
    steering_rad: float | None = None
    """Commanded angle of the steered wheels, rad, positive to the left. None if there are none, or the robot is at
    rest."""
    stands_within_m: float = 0.0
    """Stopping distance: from any fault that failstop can detect until the robot is at rest, m, at the current speed
    limit."""
    scale: Scale = Scale()
    """Whether the wheels turn as fast as commanded."""
    turning: Turning = Turning()
    """What is known about the wheels now, whatever they were told."""
    enabled_ns: int = 0
    """When motion was enabled (CLOCK_MONOTONIC, ns); 0 while it is not. It differs after a disable and an enable,
    however quickly one follows the other."""
    servos: dict[str, tuple[float, int]] = dataclasses.field(default_factory=dict)
    """Load (a share of the most that it gives, signed) and temperature in degrees C of each servo, by the part that it
    turns."""
    servos_wrong: dict[str, str] = dataclasses.field(default_factory=dict)
    """What is wrong with each servo that does not answer or reports an error, by the part that it turns."""
    ages: Ages = Ages()
    """How old the readings are."""
    battery_ns: int = 0
    """When `battery_v` was read (CLOCK_MONOTONIC, ns); 0: never."""

    @property
    def block(self) -> Block | None:
        """Why the wheels may not turn; None when they may."""
        return Block.of(self.blocked)

    @property
    def moving(self) -> bool:
        """True while the gate commands a velocity."""
        return self.blocked is None and any(self.wheels_radps)

    def source_that(self, state: str) -> Source | None:
        """The highest source in this state: drives, waits, held or silent."""
        return next((source for source in self.sources if source.state == state), None)

    def is_current(self, age_s: float | None) -> bool:
        """Whether a reading of this age says something about now. None does once the board says nothing any more."""
        heard = self.device.state == "open" and self.device.link not in (LINK_SILENT, LINK_UNHEARD)
        return heard and (age_s or 0.0) < OLD_S

    @property
    def driver(self) -> Source | None:
        """The source whose command moves the wheels, or would; None if there is none."""
        return self.source_that("drives")

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as in `failstop status --json`."""
        found = dataclasses.asdict(dataclasses.replace(self, cause=None, last_stop=None))
        found |= {"imu": self.imu and self.imu._asdict(), "odometry": self.odometry and self.odometry._asdict()}
        stop = self.last_stop and {**vars(self.last_stop), "cause": self.last_stop.cause.as_map()}
        return {**found, "cause": self.cause and self.cause.as_map(), "last_stop": stop}

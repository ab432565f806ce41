"""Snapshot: what a service tells of itself, as values with names. Times are s, lengths m, angles rad, voltages V."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any, Literal, NamedTuple

from failstop.messages import box, records
from failstop.policy.causes import Cause
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.proofs import LINK_SILENT, LINK_UNHEARD

PadMode = Literal["locked", "drive", "joint"]


class Block(enum.Enum):
    """Why the wheels may not turn; the first that holds is told."""

    LATCHED = "latched"
    """A stop is latched: `State.cause`. It takes a reset."""
    DISABLED = "disabled"
    """Nobody has enabled motion since the start, the last stop or the last disable."""
    HELD = "let go first"
    """Whoever commands did so before motion was enabled: it counts after a zero or a pause."""
    NO_COMMAND = "no command"
    """No source has a command that is younger than its timeout."""
    NO_SCAN = "no scan"
    """The obstacle sensor is silent; without it only a person may drive."""

    @classmethod
    def of(cls, text: str | None) -> Block | None:
        """The block of the gate's words (`State.blocked`)."""
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
    """The speed of each wheel in rad/s: positive is forward, and of three omni wheels counter-clockwise."""

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
    """What is known of the wheels now, from the board's reports or from the IMU."""

    does: Literal["unknown", "still", "turning"] = "unknown"
    """turning; still; unknown: nothing has been read, or not for half a second."""
    by: Literal["", "IMU", "wheels"] = ""
    """What says so: wheels (the board's reports of them) or IMU, which only feels that the robot moves, or is moved."""
    unexpected: bool = False
    """They turn although they were told zero for longer than the setting still.after_s allows."""
    since_s: float | None = None
    """For how long it has been so, s; None: not known."""
    age_s: float | None = None
    """Age of the newest reading, s; None: there was none."""
    last: Literal["unknown", "still", "turning"] = "unknown"
    """What the newest reading said, however old it is."""
    speeds_radps: Wheels | None = None
    """Measured speed of each wheel, rad/s, positive forward, by the names of `Wheels`; None: the board reports none."""
    turned_rad: Wheels | None = None
    """How far each wheel has turned since the first report, rad, positive forward: counted by the board, or added up
    from its speeds. None: the board reports none."""


OLD_S = 10.0
"""A reading as old as this says nothing of now."""


@dataclasses.dataclass(frozen=True)
class Ages:
    """Ages of the newest readings, s; None: there was none in this run."""

    board_s: float | None = None
    """Since the board said anything, of whatever kind."""
    battery_s: float | None = None
    """Of `State.battery_v`."""
    imu_s: float | None = None
    """Of `State.imu`."""
    odometry_s: float | None = None
    """Of `State.odometry`."""
    servos_s: float | None = None
    """Of `State.servos`."""


@dataclasses.dataclass(frozen=True)
class Scale:
    """Whether the wheels turn as fast as they are told (setting board.per_rps)."""

    capped: str = ""
    """Nobody has confirmed board.per_rps, so speeds are capped: in words, with the remedy; empty: it is known."""
    wheels: float | None = None
    """Measured speed of the wheels over the told one, by reports in a unit of their own; None: not known."""
    turn: float | None = None
    """Measured turn of the robot over the told one, by the gyro; None: not known."""
    wrong: tuple[str, ...] = ()
    """What differs, in words, with the setting to look at."""
    remarks: tuple[str, ...] = ()
    """What differs by less, so that a slope, a load, the battery or skidding wheels may explain it."""


@dataclasses.dataclass(frozen=True)
class Stop:
    """The last stop, and the three proofs of it; one is None while it is not known."""

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
    """Written: from noticing the cause until the kernel had the bytes, s. None: they could not be written."""
    acknowledged_s: float | None
    """Acknowledged: until the board answered a ping that was written after the stop, or reported to obey it, s."""
    observed_s: float | None
    """Observed: until the wheels were seen still, s; 0: they were not seen moving before the stop either."""
    epoch: int = 0
    """That was raised for it: whoever asked for a stop in an earlier one was answered by this."""
    sent: bool = True
    """False: its bytes were found to be still in the kernel; the board takes none."""
    acknowledged_by: str = "answer"
    """The proof by which the board acknowledges: answer (to a ping), echo (of what it obeys); empty: by none."""
    observed_by: str = "IMU"
    """Source of `observed_s`: IMU, or wheels (the board's own reports of them); empty: the robot has no IMU."""
    noticed_ns: int = 0
    """When the cause was noticed (CLOCK_MONOTONIC, ns): the same whatever the wall clock is set to."""
    believed: bool = True
    """False: the device that took its bytes has not answered as the board does."""


@dataclasses.dataclass(frozen=True)
class Process:
    """One process of the service."""

    pid: int
    """0: there is none now."""
    state: str
    """starting, running, hanging, suspended (by a signal), fenced (for hanging), dead, waiting, down, or stopping."""
    age_s: float
    """Since its last heartbeat, s; before its first one since the begin of the run."""
    restarts: int
    """How often it was restarted in this run."""
    last_exit: str | None
    """How its predecessor died."""
    worst_s: float
    """The longest time between two turns of its loop since its start, s."""
    realtime: bool
    """It has real-time rights (SCHED_FIFO)."""
    memory_locked: bool
    """Its memory can't be swapped out."""
    early_news: bool = True
    """The kernel tells it of a death before it takes the dead process's memory down."""
    killed: bool = False
    """Its predecessor was killed by a signal."""
    starts_in_s: float | None = None
    """Time until it is started again, s; None: it runs, or needs a reset first."""


@dataclasses.dataclass(frozen=True)
class Device:
    """The port of the board."""

    path: str
    """Of its file, as the settings or `--device` name it."""
    state: Literal["closed", "open", "lost"]
    """closed, open, or lost (unplugged)."""
    link: Literal["unproven", "alive", "deaf", "silent", "unheard", "unasked"]
    """alive: it answers; unproven: it has not answered yet; deaf: it does not hear; silent: it says nothing any more;
    unheard: it has not answered since a replug; unasked: it can't answer, by its nature."""
    watchdog_s: float = 0.0
    """How long after the last frame the board's own watchdog acts, s; 0: it has none, or it is not known."""
    watchdog_does: str = ""
    """The act of that watchdog: zero (it stops the wheels), coast (they roll on without current), or disarm."""
    imu: bool = True
    """False: the robot has no IMU (setting board.imu)."""
    unheeded_s: float | None = None
    """How long the board has reported to obey zero speed while motion is commanded, s; None: it has not."""


@dataclasses.dataclass(frozen=True)
class Client:
    """A program that holds a client slot."""

    slot: int
    """0 to 7."""
    name: str
    """Its name, by its own word."""
    pid: int
    """By its own word."""
    driving: bool
    """Its command moves the wheels now."""
    sees: str = ""
    """A line on what it sees, by its own word (`Robot.say`)."""
    wrong: str = ""
    """A line on what is wrong, by its own word."""
    said_s: float | None = None
    """How long ago it said so, s; None: never."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A source with a fresh command."""

    source: str
    """Its name in the settings, or `gamepad`."""
    priority: int
    """The highest drives."""
    who: str
    """The program that commands as it: name and pid."""
    state: Literal["drives", "waits", "held", "silent"]
    """drives; waits: a higher one drives; held: it commanded before motion was enabled and must send zero or pause
    first; silent: it drove, and stopped sending commands while the wheels turned."""


@dataclasses.dataclass(frozen=True)
class Starved:
    """The longest silence in ten minutes that the machine explains, motion disabled: nothing was stopped for it."""

    longest_s: float
    """How long, s."""
    process: str
    """The process that was not run."""

    def __str__(self) -> str:
        return f"the machine starved the service: {self.process} was not run for {self.longest_s * 1e3:.0f} ms"


@dataclasses.dataclass(frozen=True)
class GyroBias:
    """The gyro's reading of a robot that stands still."""

    bias_radps: tuple[float, float, float]
    """rad/s, x forward, y left, z up."""
    tracking: bool
    """It follows the reading now."""
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
    """Of each axis of the rate, (rad/s)2."""


DEAD_RECKONING = (records.POSE_VARIANCE, 0.0, 0.0, records.POSE_VARIANCE, 0.0, records.POSE_VARIANCE)


class Odometry(NamedTuple):
    """Pose since the start and velocity, from the wheels where the board reports them, else from what was commanded."""

    t_ns: int
    """CLOCK_MONOTONIC of when it was so, ns: of the newest report of the wheels, where they count."""
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
    they did, because the board has reported nothing of them."""
    pose_covariance: tuple[float, ...] = DEAD_RECKONING
    """Of x, y (m2) and th (rad2): xx, xy, x th, yy, y th, th th. From wheels it grows with the way; from commands it is
    so large that nobody trusts the pose."""

    @property
    def pose_variance(self) -> float:
        """The largest variance of x, y (m2) and th (rad2)."""
        return max(self.pose_covariance[0], self.pose_covariance[3], self.pose_covariance[5])


class Pad(NamedTuple):
    """One frame of the gamepad."""

    t_ns: int
    """CLOCK_MONOTONIC of the read that brought it, ns."""
    buttons: int
    """A bit a button."""
    hat: int
    """As the board gives it."""
    axes: tuple[int, ...]
    """lx, ly, rx, ry, -128 to 127."""
    mode: PadMode
    """The part that the gamepad moves."""


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
    """Where it was sent, rad; None while it is not known where it is."""
    torque: bool | None
    """It holds; None: not known yet."""
    temperature_c: int | None
    """Of the servo, degrees Celsius."""
    supply_v: float | None
    """Of the servo, V."""

    @property
    def at_rad(self) -> float | None:
        """Where it is as far as is known, rad: sent (no servo is asked while it moves), or read to be."""
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
    """The program that moves it; empty: none."""
    closed: str
    """Why it takes no goal; empty: it takes one."""
    refused: str
    """Why the last goal of a stream was not taken; empty: it was."""
    released: bool
    """Its torque is off."""
    silent: tuple[int, ...]
    """Servos that do not answer."""
    wrong: tuple[str, ...]
    """Faults of it, in words."""
    pose: str
    """drive, tuck, or empty."""
    auto_tuck_s: float | None
    """Until it tucks itself, s; None: it does not."""
    pad_joint: str | None
    """The joint that the gamepad turns."""
    joints: dict[str, JointState]
    """By name."""


@dataclasses.dataclass(frozen=True)
class State:
    """One consistent snapshot: what the gate decided is one record, read whole."""

    name: str
    """Of the service."""
    enabled: bool
    """Motion is enabled."""
    estop: str | None
    """The text of `cause`."""
    cause: Cause | None
    """The latched stop: the first cause since the last reset; None: nothing is."""
    blocked: str | None
    """Why the wheels may not turn, in the gate's words; None when they may. Programs compare `block`."""
    body_vel: Velocity
    """The velocity that the gate commands."""
    wheels_radps: Wheels
    """The speed that it commands of each wheel."""
    epoch: int
    """Raised by every stop."""
    waiting_for: str | None
    """The part that is not up yet; motion can't be enabled until it is."""
    device: Device
    """The port of the board."""
    processes: dict[str, Process]
    """By name."""
    starved: Starved | None
    """None: the machine has run every process in time for ten minutes."""
    clients: tuple[Client, ...]
    """The holders of the client slots."""
    sources: tuple[Source, ...]
    """The source that drives and those that wait, highest priority first."""
    scan_age_s: float | None
    """Since the obstacle sensor delivered last, s; None: never."""
    last_stop: Stop | None
    """None: there was none in this run."""
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
    """Of the gate's record, s: it publishes every 0.08 s at least."""
    speed_limit: float = 1.0
    """The share of the settings' speeds that drivers may use (`Robot.limit_speed`)."""
    attended_by: tuple[str, ...] | None = None
    """The operators who are there; None: none is needed (setting attend.required)."""
    arm: ArmState | None = None
    """None without an arm in the settings, and while a service starts, until its gate has told of the arm."""
    unmet: str = ""
    """The reason why an interlock does not hold, in the words of its refusal; empty: all that are declared hold."""
    starved_times: int = 0
    """How often in this run the machine explained a silence as `starved` does."""
    lease_s: float = 0.06
    """Longest silence of gate or supervisor while wheels turn, s (gate.lease_s; longer without real-time rights)."""
    steering_rad: float | None = None
    """Commanded angle of the steered wheels, rad, positive to the left. None: there are none, or the robot stands."""
    stands_within_m: float = 0.0
    """Stopping distance: from any fault that software answers until the robot stands, m, at the speed limit of now."""
    scale: Scale = Scale()
    """Whether the wheels turn as fast as they are told."""
    turning: Turning = Turning()
    """What is known of the wheels now, whatever they were told."""
    enabled_ns: int = 0
    """When motion was enabled (CLOCK_MONOTONIC, ns); 0: it is not. It differs after a disable and an enable, however
    soon one follows the other."""
    servos: dict[str, tuple[float, int]] = dataclasses.field(default_factory=dict)
    """By the part that each turns: load (a share of the most that it gives, signed) and temperature in degrees C."""
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
        """The gate commands a velocity."""
        return self.blocked is None and any(self.wheels_radps)

    def source_that(self, state: str) -> Source | None:
        """The highest source in this state: drives, waits, held or silent."""
        return next((source for source in self.sources if source.state == state), None)

    def is_current(self, age_s: float | None) -> bool:
        """Whether a reading of this age says something of now: it does not once the board says nothing any more."""
        heard = self.device.state == "open" and self.device.link not in (LINK_SILENT, LINK_UNHEARD)
        return heard and (age_s or 0.0) < OLD_S

    @property
    def driver(self) -> Source | None:
        """The source whose command moves the wheels, or would; None: there is none."""
        return self.source_that("drives")

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as in `failstop status --json`."""
        found = dataclasses.asdict(dataclasses.replace(self, cause=None, last_stop=None))
        found |= {"imu": self.imu and self.imu._asdict(), "odometry": self.odometry and self.odometry._asdict()}
        stop = self.last_stop and {**vars(self.last_stop), "cause": self.last_stop.cause.as_map()}
        return {**found, "cause": self.cause and self.cause.as_map(), "last_stop": stop}

"""Snapshot: the types of the service's state. Times are in s, lengths in m, angles in rad, voltages in V."""

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
    """Why the wheels may not turn. If several reasons apply, the first one in this order is given."""

    LATCHED = "latched"
    """A stop is latched: `State.cause`. It needs a reset."""
    DISABLED = "disabled"
    """Motion was not enabled since the start, the last stop or the last disable."""
    HELD = "let go first"
    """The source has been commanding a velocity since before motion was enabled. Its commands count after a zero or a
    pause."""
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
    """turning, still, or unknown: nothing was read yet, or nothing for half a second."""
    by: Literal["", "IMU", "wheels"] = ""
    """What has observed it: wheels (the board's reports about them), or IMU, which only feels whether the robot moves
    or is moved."""
    unexpected: bool = False
    """True if the wheels turn although they were told zero for longer than the setting still.after_s allows."""
    since_s: float | None = None
    """For how long this has been so, s; None if not known."""
    age_s: float | None = None
    """Age of the newest reading, s; None if there was none."""
    last: Literal["unknown", "still", "turning"] = "unknown"
    """What the newest reading showed, however old it is."""
    speeds_radps: Wheels | None = None
    """Measured speed of each wheel, rad/s, positive forward, by the names of `Wheels`; None if the board reports
    none."""
    turned_rad: Wheels | None = None
    """How far each wheel has turned since the first report, rad, positive forward: as the board has counted it, or
    added up from its speeds. None if the board reports neither."""


OLD_S = 10.0
"""A reading that is older than this, s, says nothing about now."""


@dataclasses.dataclass(frozen=True)
class Ages:
    """Ages of the newest readings, s; None if there was none in this run."""

    board_s: float | None = None
    """Since the board last sent anything, of any kind."""
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
    """The text, with the remedy, that speeds are capped because nobody has confirmed board.per_rps; empty if it is
    confirmed."""
    wheels: float | None = None
    """Measured wheel speed divided by the commanded one, from reports in a unit of their own; None: not known."""
    turn: float | None = None
    """Measured turn rate of the robot divided by the commanded one, from the gyro; None: not known."""
    wrong: tuple[str, ...] = ()
    """What differs, in words, with the setting to look at."""
    remarks: tuple[str, ...] = ()
    """What differs by less, in words. A slope, a load, the battery or skidding wheels may explain it."""


@dataclasses.dataclass(frozen=True)
class Stop:
    """The last stop, and its three proofs, each of which is None until it is known."""

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
    """The epoch that was raised for this stop. Requests for a stop that were made in an earlier epoch are answered by
    it too."""
    sent: bool = True
    """False if the bytes of the stop were found to be still in the kernel, because the board takes none."""
    acknowledged_by: str = "answer"
    """How the board acknowledges: answer (to a ping), echo (of what it obeys); empty: not at all."""
    observed_by: str = "IMU"
    """What has made `observed_s` known: IMU, or wheels (the board's own reports about them); empty if the robot has no
    IMU."""
    noticed_ns: int = 0
    """When the cause was noticed (CLOCK_MONOTONIC, ns). It does not depend on the wall clock."""
    believed: bool = True
    """False until the device that got the bytes has answered as the board does."""


@dataclasses.dataclass(frozen=True)
class Process:
    """One process of the service."""

    pid: int
    """0 while no such process exists."""
    state: str
    """starting, running, hanging, suspended (by a signal), fenced (for hanging), dead, waiting, down, or stopping."""
    age_s: float
    """The time since its last heartbeat, s; before its first one, since the beginning of the run."""
    restarts: int
    """How often it was restarted in this run."""
    last_exit: str | None
    """How the process before it died."""
    worst_s: float
    """The longest time between two turns of its loop since its start, s."""
    realtime: bool
    """True if it has real-time rights (SCHED_FIFO)."""
    memory_locked: bool
    """True if its memory can't be swapped out."""
    early_news: bool = True
    """True if the kernel tells this process about a death before it frees the memory of the dead process."""
    killed: bool = False
    """True if a signal has killed the process before it."""
    starts_in_s: float | None = None
    """After how long it will be started again, s; None if it is running, or needs a reset first."""


@dataclasses.dataclass(frozen=True)
class Device:
    """The board's port."""

    path: str
    """Path of its file, as the settings or `--device` name it."""
    state: Literal["closed", "open", "lost"]
    """closed, open, or lost (unplugged)."""
    link: Literal["unproven", "alive", "deaf", "silent", "unheard", "unasked"]
    """alive: it answers; unproven: it has not answered yet; deaf: it does not hear; silent: it says nothing any more;
    unheard: it has not answered since a replug; unasked: it can't answer, by design."""
    watchdog_s: float = 0.0
    """How long after the last frame the board's own watchdog acts, s; 0 if it has none, or that is not known."""
    watchdog_does: str = ""
    """What that watchdog does: zero (it stops the wheels), coast (they roll on without current), or disarm."""
    imu: bool = True
    """False if the robot has no IMU (setting board.imu)."""
    unheeded_s: float | None = None
    """For how long the board has reported that it obeys zero speed although motion is commanded, s; None if it does
    not."""


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
    """True if its command moves the wheels now."""
    sees: str = ""
    """A line on what it sees, as it reports it (`Robot.say`)."""
    wrong: str = ""
    """A line on what is wrong, as it reports it."""
    said_s: float | None = None
    """When it last reported that, s ago; None: never."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A source whose last command still counts."""

    source: str
    """Its name in the settings, or `gamepad`."""
    priority: int
    """The source with the highest priority drives."""
    who: str
    """The program that commands as this source: name and pid."""
    state: Literal["drives", "waits", "held", "silent"]
    """drives; waits: a source with a higher priority drives; held: it has been commanding since before motion was
    enabled, and must send zero or pause first; silent: it drove, and stopped sending commands while the wheels
    turned."""

    def __str__(self) -> str:
        """The program, and its source unless that is the one that every program has by default."""
        return self.who if self.source == FIRST_SOURCE else f"{self.who} as {self.source}"


@dataclasses.dataclass(frozen=True)
class Starved:
    """The longest silence of a process in the last ten minutes for which nothing was stopped, because the machine did
    not run the process and motion was disabled."""

    longest_s: float
    """How long the silence was, s."""
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
    """True if the bias follows the readings now."""
    calibrated: bool
    """True if the robot was at rest for long enough at the start."""


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
    """The pose since the start, and the velocity, computed from the wheels' turns if the board reports them, else from
    the commands."""

    t_ns: int
    """The time of the pose (CLOCK_MONOTONIC, ns): that of the wheels' newest report, if it is computed from reports."""
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
    """wheels: computed from how far the board reports that the wheels have turned. commands: computed from how far they
    were told to turn, whatever they did, because the board has reported nothing about them."""
    pose_covariance: tuple[float, ...] = DEAD_RECKONING
    """Covariance of x, y (m2) and th (rad2): xx, xy, x th, yy, y th, th th. If the pose is computed from the wheels, it
    grows with the distance; if it is computed from commands, it is so large that nobody should trust the pose."""

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
    """The hat's value, as the board reports it."""
    axes: tuple[int, ...]
    """lx, ly, rx, ry, -128 to 127."""
    mode: PadMode
    """What the gamepad moves: locked (nothing), drive (the wheels) or joint (the arm)."""


Sample = Imu | Pad | Odometry
"""A sample of `Robot.samples`."""


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
    """Since when the position was read, s."""
    commanded_rad: float | None
    """Where it was sent, rad; None while its position is not known."""
    torque: bool | None
    """True if the torque is on; None: not known yet."""
    temperature_c: int | None
    """Temperature of the servo, degrees Celsius."""
    supply_v: float | None
    """Supply voltage of the servo, V."""

    @property
    def at_rad(self) -> float | None:
        """Where the joint is as far as is known, rad: where it was sent, because no servo is asked while it moves, or
        else where it was read to be."""
        return self.angle_rad if self.commanded_rad is None else self.commanded_rad


@dataclasses.dataclass(frozen=True)
class ArmState:
    """The state of the arm."""

    mode: str
    """trajectory, follow, jog, or empty."""
    phase: str
    """How far a trajectory has come."""
    moving: bool
    """True if it moves now."""
    by: str
    """The program that moves it; empty if none does."""
    closed: str
    """Why the arm accepts no goal; empty if it accepts one."""
    refused: str
    """Why the last goal of a stream was not accepted; empty if it was."""
    released: bool
    """True if its torque is off."""
    silent: tuple[int, ...]
    """Servos that do not answer."""
    wrong: tuple[str, ...]
    """The faults of the arm, in words."""
    pose: str
    """The pose that the arm is in: drive, tuck, or empty for neither."""
    auto_tuck_s: float | None
    """After how long the arm will tuck itself, s; None if it will not."""
    pad_joint: str | None
    """The joint that the gamepad turns."""
    joints: dict[str, JointState]
    """The joints by name."""


@dataclasses.dataclass(frozen=True)
class State:
    """One consistent snapshot of the service. The gate's decision is one record, which is read whole."""

    name: str
    """Name of the service."""
    enabled: bool
    """True if motion is enabled."""
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
    """A number that every stop raises."""
    waiting_for: str | None
    """What is not ready yet; motion can't be enabled until it is."""
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
    """The time since the obstacle sensor last delivered, s; None: never."""
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
    """Whether a charger is plugged in, judged by steps of the voltage."""
    age_s: float
    """The age of the gate's record, s. The gate publishes at least every 0.08 s."""
    speed_limit: float = 1.0
    """The share of the settings' speeds that drivers may use (`Robot.limit_speed`)."""
    attended_by: tuple[str, ...] | None = None
    """The operators who are present; None if none is needed (setting attend.required)."""
    arm: ArmState | None = None
    """None without an arm in the settings, and while a service starts, until its gate has reported the arm."""
    unmet: str = ""
    """Why an interlock does not hold, in the words of its refusal; empty if all declared interlocks hold."""
    starved_times: int = 0
    """How often in this run a silence was excused as in `starved`."""
    lease_s: float = 0.06
    """For how long the gate or the supervisor may be silent while the wheels turn, s (gate.lease_s; longer without
    real-time rights)."""
    steering_rad: float | None = None
    """Commanded angle of the steered wheels, rad, positive to the left. None if there are none, or the robot is at
    rest."""
    stands_within_m: float = 0.0
    """The stopping distance at the present speed limit: how far the robot goes after any fault that failstop can
    detect, until it is at rest, m."""
    scale: Scale = Scale()
    """Whether the wheels turn as fast as commanded."""
    turning: Turning = Turning()
    """What is known about the wheels now, whatever they were told."""
    enabled_ns: int = 0
    """When motion was enabled (CLOCK_MONOTONIC, ns); 0 while it is not. It differs after a disable and an enable,
    however quickly one follows the other."""
    servos: dict[str, tuple[float, int]] = dataclasses.field(default_factory=dict)
    """The load (a share of the most that the servo gives, signed) and the temperature in degrees C of each servo, by
    the part that it turns."""
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
        """The source in this state (drives, waits, held or silent) with the highest priority."""
        return next((source for source in self.sources if source.state == state), None)

    def is_current(self, age_s: float | None) -> bool:
        """True if a reading of this age says something about now. No reading does once the board has stopped
        sending."""
        heard = self.device.state == "open" and self.device.link not in (LINK_SILENT, LINK_UNHEARD)
        return heard and (age_s or 0.0) < OLD_S

    @property
    def driver(self) -> Source | None:
        """The source whose command moves the wheels, or would move them; None if there is none."""
        return self.source_that("drives")

    def as_dict(self) -> dict[str, Any]:
        """The state as plain values, as `failstop status --json` prints it."""
        found = dataclasses.asdict(dataclasses.replace(self, cause=None, last_stop=None))
        found |= {"imu": self.imu and self.imu._asdict(), "odometry": self.odometry and self.odometry._asdict()}
        stop = self.last_stop and {**vars(self.last_stop), "cause": self.last_stop.cause.as_map()}
        return {**found, "cause": self.cause and self.cause.as_map(), "last_stop": stop}

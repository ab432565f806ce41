"""Snapshot: the types that make up the service's state. Times are in s, lengths in m, angles in rad, voltages in V."""

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
    """Why the wheels may not turn. If several reasons apply, `State.block` is the first in the order of this class."""

    LATCHED = "latched"
    """A stop is latched (`State.cause`). It needs a reset."""
    DISABLED = "disabled"
    """Motion is disabled. It is disabled after every start of the service, after every stop, and whenever somebody
    disables it."""
    HELD = "let go first"
    """A source was already commanding a velocity at the moment when motion was enabled. For safety, its commands count
    only after it has sent zero or paused. For example, a person must let go of the stick first."""
    NO_COMMAND = "no command"
    """No source has sent a command recently, so every command has expired."""
    NO_SCAN = "no scan"
    """The obstacle sensor is silent. While it is silent, only a person may drive."""

    @classmethod
    def of(cls, text: str | None) -> Block | None:
        """The Block for a text of the gate (`State.blocked`). None if the text is None."""
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
    """One value for each wheel: its speed in rad/s, or how far it has turned in rad. A positive value means forward. On
    a base with three omni wheels, a positive value turns the robot counter-clockwise."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the wheels, in the order of the values. Four wheels: front_left, rear_left, front_right,
        rear_right. Three wheels: left, rear, right. Two wheels: left, right."""
        return tuple(name.replace(" ", "_") for name in WHEEL_NAMES[len(self)])

    def __getattr__(self, name: str) -> float:
        if name in self.names:
            return self[self.names.index(name)]
        raise AttributeError(f"no wheel {name!r}: this robot has {', '.join(self.names)}", name=name, obj=self)


@dataclasses.dataclass(frozen=True)
class Turning:
    """What is known about the wheels at present, from the board's reports or from the IMU."""

    does: Literal["unknown", "still", "turning"] = "unknown"
    """What the wheels do: turning, still, or unknown. It is unknown if there was no reading yet, or if the newest
    reading is more than half a second old."""
    by: Literal["", "IMU", "wheels"] = ""
    """How `does` is known. `wheels`: the board reports about the wheels. `IMU`: the IMU feels whether the robot moves.
    It can't feel wheels that turn in the air, and it also feels a robot that somebody moves. Empty if `does` is
    unknown."""
    unexpected: bool = False
    """True if the wheels still turn although zero was commanded longer ago than the setting `still.after_s`."""
    since_s: float | None = None
    """How long `does` has had its present value, in s. None if not known."""
    age_s: float | None = None
    """The age of the newest reading, in s. None if there was no reading."""
    last: Literal["unknown", "still", "turning"] = "unknown"
    """What the newest reading showed, however old it is."""
    speeds_radps: Wheels | None = None
    """The measured speed of each wheel, rad/s, positive forward, in the order of `Wheels.names`. None if the board does
    not report speeds."""
    turned_rad: Wheels | None = None
    """How far each wheel has turned since the first report, in rad, positive forward. If the board reports only speeds,
    the turns are computed from the speeds. None if the board reports neither."""


OLD_S = 10.0
"""A reading that is older than this, in s, says nothing about the present."""


@dataclasses.dataclass(frozen=True)
class Ages:
    """The age of the newest reading of each kind, in s. None if there was no such reading in this run."""

    board_s: float | None = None
    """The time since the board last sent anything."""
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
    """The result of checking the setting board.per_rps: how fast the wheels turn, compared with how fast they are
    commanded to turn."""

    capped: str = ""
    """Says that speeds are capped, and how to end that. Empty once a person has confirmed board.per_rps."""
    wheels: float | None = None
    """Measured wheel speed divided by commanded wheel speed. None if not known. Always None if the board reports and
    takes speeds in the same unit, because the ratio would then be right even with a wrong board.per_rps."""
    turn: float | None = None
    """The robot's turn rate as the gyro measures it, divided by the commanded turn rate. None if not known."""
    wrong: tuple[str, ...] = ()
    """Differences between measured and commanded speeds that are too large, in words, each with the setting to
    check."""
    remarks: tuple[str, ...] = ()
    """Smaller differences between measured and commanded speeds, in words. The reason can be a slope, a load, the
    battery or skidding wheels."""


@dataclasses.dataclass(frozen=True)
class Stop:
    """The last stop, with its three proofs: written, acknowledged and observed. Each proof is None until it has been
    obtained."""

    cause: Cause
    """Why the robot was stopped."""
    reason: str
    """The text of `cause`."""
    t: float
    """When the robot was stopped (Unix time, s)."""
    noticed_by: str
    """The process that noticed the cause."""
    written_by: str
    """The process that wrote the stop to the board."""
    written_s: float | None
    """The first proof: the time from when the cause was noticed until the kernel had the bytes of the stop, in s. None
    if the bytes could not be written."""
    acknowledged_s: float | None
    """The second proof: the time from when the cause was noticed until the board acknowledged the stop, in s. A board
    acknowledges a stop in one of two ways (`acknowledged_by`): it answers a ping that was written after the stop, or it
    reports that it now obeys the stop."""
    observed_s: float | None
    """The third proof: the time from when the cause was noticed until the wheels were seen still, in s. 0 if the wheels
    were already seen still before the stop. See also `observed_late`."""
    epoch: int = 0
    """The number of the epoch that began with this stop. To wait for a stop that you request, remember `State.epoch`
    before the request, and wait for a stop with a higher epoch."""
    sent: bool = True
    """False if the bytes of the stop are still in the kernel, because the board accepts no bytes."""
    acknowledged_by: str = "answer"
    """How this board acknowledges a stop: `answer` (the board answers pings), `echo` (the board reports which command
    it obeys), or empty (this board never acknowledges a stop)."""
    observed_by: str = "IMU"
    """What has observed the wheels: `wheels` (the board's own reports about them) or `IMU`. Empty if nothing can
    observe them, because the board reports nothing about the wheels and the robot has no IMU."""
    noticed_ns: int = 0
    """When the cause was noticed (CLOCK_MONOTONIC, ns). Unlike `t`, it does not depend on the wall clock."""
    believed: bool = True
    """True if the device on the port has answered as a board of this kind does. While this is False, the stop may have
    gone to a device that is not the board."""
    observed_late: bool = False
    """True if nothing showed the wheels for a while before they were seen still, for example because the board was
    silent. They may have come to rest before `observed_s`."""


@dataclasses.dataclass(frozen=True)
class Process:
    """One process of the service."""

    pid: int
    """The pid of the process. 0 while the process does not exist, for example before it is started again."""
    state: str
    """What the process does: starting, running, hanging, suspended, fenced, dead, waiting, down or stopping. suspended:
    by a signal. fenced: killed because it hung, but the kernel has not ended it yet. waiting: it will be started. down:
    it has died too often, so it is started again only after a pause or a reset."""
    age_s: float
    """The time since its last heartbeat, in s. Before the first heartbeat, it is the time since the beginning of the
    run."""
    restarts: int
    """How often it was restarted in this run."""
    last_exit: str | None
    """How the previous process with this name died. None if no process with this name has died."""
    worst_s: float
    """The longest time between two heartbeats of this process, in s. A process has one heartbeat in each pass through
    its loop."""
    realtime: bool
    """True if it has real-time rights (SCHED_FIFO)."""
    memory_locked: bool
    """True if its memory can't be swapped out."""
    early_news: bool = True
    """True if this process learns of the death of another process early, which means before the kernel frees the memory
    of the dead process."""
    killed: bool = False
    """True if the previous process with this name (see `last_exit`) was killed by a signal."""
    starts_in_s: float | None = None
    """The time until the process is started again, in s. None if no start is planned, for example because the process
    is running, or because only a reset starts it."""


@dataclasses.dataclass(frozen=True)
class Device:
    """The port of the board."""

    path: str
    """The path of the port, as the settings or `--device` name it."""
    state: Literal["closed", "open", "lost"]
    """closed, open, or lost (the board was unplugged)."""
    link: Literal["unproven", "alive", "deaf", "silent", "unheard", "unasked"]
    """What is known about the connection to the board. unproven: the board has not answered yet. alive: the board
    answers. deaf: the board does not hear. silent: the board has stopped sending anything. unheard: the board was
    plugged in again, and has not answered since. unasked: this kind of board never answers."""
    watchdog_s: float = 0.0
    """The time from the last motion frame until the board's own watchdog acts, in s. 0 if the board has no watchdog, or
    if this time is not known."""
    watchdog_does: str = ""
    """What the watchdog does. `zero`: it stops the wheels. `coast`: the wheels roll on without current. `disarm`: the
    wheels stop, and the board accepts no motion until it is armed again. Empty if the board has no watchdog, or if it
    is not known what the watchdog does."""
    imu: bool = True
    """False if the robot has no IMU (setting board.imu)."""
    unheeded_s: float | None = None
    """For how long the board has reported that it obeys a speed of zero although motion is commanded, in s. None if it
    does not report that."""


@dataclasses.dataclass(frozen=True)
class Client:
    """A program that holds a client slot."""

    slot: int
    """The number of the slot, 0 to 7."""
    name: str
    """The name that the program gives itself."""
    pid: int
    """The pid of the program, as the program itself reports it."""
    driving: bool
    """True if its command moves the wheels at present."""
    sees: str = ""
    """A line in which the program says what it sees (`Robot.say`)."""
    wrong: str = ""
    """A line in which the program says what is wrong; empty if nothing is."""
    said_s: float | None = None
    """How long ago the program sent `sees` and `wrong`, in s. None if it has not sent them."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A source of commands. It is listed until its last command expires. If the last driver is a program that stopped
    sending commands while the wheels turned, its source stays listed, with the state "silent"."""

    source: str
    """Its name in the settings, or `gamepad`."""
    priority: int
    """Its priority. The source with the highest priority drives."""
    who: str
    """The program that commands as this source, with its name and pid."""
    state: Literal["drives", "waits", "held", "silent"]
    """What the source does. drives: its command moves the wheels. waits: a source with a higher priority drives. held:
    it was already commanding a velocity when motion was enabled, so its commands count only after it has sent zero or
    paused. silent: it stopped sending commands while the wheels turned."""

    def __str__(self) -> str:
        """The program that commands, and the name of the source unless it is cmd_vel, the default."""
        return self.who if self.source == FIRST_SOURCE else f"{self.who} as {self.source}"


@dataclasses.dataclass(frozen=True)
class Starved:
    """The longest time for which the machine was too busy to run a process of the service. If motion is enabled at such
    a time, the robot is stopped. The values are shown until ten minutes pass without such a time."""

    longest_s: float
    """For how long the machine did not run the process, in s."""
    process: str
    """The process that the machine did not run."""

    def __str__(self) -> str:
        return f"the computer is too busy: {self.process} did not run for {self.longest_s * 1e3:.0f} ms"


@dataclasses.dataclass(frozen=True)
class GyroBias:
    """The gyro's reading at rest. It is subtracted from every reading."""

    bias_radps: tuple[float, float, float]
    """rad/s, x forward, y left, z up."""
    tracking: bool
    """True if the bias is being updated from the gyro's readings at present."""
    calibrated: bool
    """True if the bias was measured after the service was started. For that, the robot must stay at rest for long
    enough."""


class Imu(NamedTuple):
    """One sample of the IMU. The axes are x forward, y left, z up."""

    t_ns: int
    """When the sample was read (CLOCK_MONOTONIC, ns)."""
    acceleration_mps2: tuple[float, ...]
    """The acceleration, m/s2."""
    rate_radps: tuple[float, ...]
    """The turn rate, rad/s, without the bias."""
    rate_variance: float = records.RATE_VARIANCE
    """The variance of each axis of the turn rate, (rad/s)2."""


DEAD_RECKONING = (records.POSE_VARIANCE, 0.0, 0.0, records.POSE_VARIANCE, 0.0, records.POSE_VARIANCE)


class Odometry(NamedTuple):
    """The robot's velocity, and its pose relative to where the service was started. Both are computed from how far the
    board reports that the wheels have turned. Without such reports, they are computed from the commands (see
    `source`)."""

    t_ns: int
    """The time of the pose (CLOCK_MONOTONIC, ns). If the pose is computed from the board's reports, this is the time of
    the newest report."""
    x_m: float
    """The position, m, along the direction in which the robot pointed when the service was started."""
    y_m: float
    """The position, m, along the direction that was to the left of the robot when the service was started."""
    th_rad: float
    """How far the robot has turned since the service was started, rad counter-clockwise."""
    vx_mps: float
    """Velocity forward, m/s."""
    vy_mps: float
    """Velocity to the left, m/s."""
    wz_radps: float
    """Turn rate, rad/s counter-clockwise."""
    twist_std_mps: float
    """Standard deviation of vx and vy, m/s, from the settings."""
    twist_std_radps: float
    """Standard deviation of wz, rad/s, from the settings."""
    source: Literal["commands", "wheels"] = "commands"
    """Where the pose comes from. `wheels`: it is computed from the board's reports about how far the wheels have
    turned. `commands`: the board reports nothing about the wheels, so the pose is computed from the commands and does
    not show what the wheels really did."""
    pose_covariance: tuple[float, ...] = DEAD_RECKONING
    """Covariance of x, y (m2) and th (rad2), in the order xx, xy, x th, yy, y th, th th. With the source `wheels`, the
    covariance grows with the distance. With the source `commands`, the covariance is huge, because nobody should trust
    such a pose."""

    @property
    def pose_variance(self) -> float:
        """The largest variance of x, y (m2) and th (rad2)."""
        return max(self.pose_covariance[0], self.pose_covariance[3], self.pose_covariance[5])


class Pad(NamedTuple):
    """One frame of the gamepad."""

    t_ns: int
    """When the frame was read (CLOCK_MONOTONIC, ns)."""
    buttons: int
    """The buttons that are pressed, one bit per button."""
    hat: int
    """The hat's value, as the board reports it."""
    axes: tuple[int, ...]
    """The sticks: lx, ly, rx, ry, each from -128 to 127."""
    mode: PadMode
    """What the gamepad moves: locked (nothing), drive (the wheels) or joint (the arm)."""


Sample = Imu | Pad | Odometry
"""One sample from `Robot.samples`."""


@dataclasses.dataclass(frozen=True)
class JointState:
    """One joint of the arm."""

    servo: int
    """The id of its servo on the bus."""
    angle_rad: float | None
    """The measured angle, rad. None until it was read."""
    pulses: int | None
    """The measured position in the servo's pulses. None until it was read."""
    age_s: float | None
    """How long ago the position was read, in s. None until it was read."""
    commanded_rad: float | None
    """The commanded angle of the joint, rad. None while the position of the joint is not known."""
    torque: bool | None
    """True if the torque is on, False if it is off. None if that is not known, for example because the servo does not
    answer."""
    temperature_c: int | None
    """The temperature of the servo, degrees Celsius. None if not known."""
    supply_v: float | None
    """The supply voltage of the servo, V. None if not known."""

    @property
    def at_rad(self) -> float | None:
        """The best known angle of the joint, rad: the commanded angle, or else the measured one. None if neither is
        known. The commanded angle comes first, because a servo is not asked for its position while it moves."""
        return self.angle_rad if self.commanded_rad is None else self.commanded_rad


@dataclasses.dataclass(frozen=True)
class ArmState:
    """The state of the arm."""

    mode: str
    """How the arm is being moved: trajectory, follow or jog. Empty if it is not being moved."""
    phase: str
    """What the arm does at present for its trajectory, in words, for example settling. Empty if the arm follows no
    trajectory."""
    moving: bool
    """True if the arm is moving."""
    by: str
    """The program that moves the arm. Empty if no program moves it."""
    closed: str
    """Why the arm accepts no goal at present. Empty if it accepts goals."""
    refused: str
    """Why the last goal from arm.follow() or arm.jog() was refused, or why the arm can't move toward it, for example
    because a servo does not answer. Empty if there is no such reason."""
    released: bool
    """True if the arm's torque is off."""
    silent: tuple[int, ...]
    """The ids of servos that do not answer."""
    wrong: tuple[str, ...]
    """What is wrong with the arm, in words."""
    pose: str
    """The pose in which the arm is: drive, tuck, or empty if it is in neither."""
    auto_tuck_s: float | None
    """In how many seconds the arm will move to its tuck pose by itself. None if no such move is planned."""
    pad_joint: str | None
    """The joint that the gamepad turns at present. None if the gamepad turns no joint."""
    joints: dict[str, JointState]
    """The joints by name."""


@dataclasses.dataclass(frozen=True)
class State:
    """One consistent snapshot of the service. All parts of the gate's decision are from the same moment."""

    name: str
    """Name of the service."""
    enabled: bool
    """True if motion is enabled."""
    estop: str | None
    """The text of `cause`. None if no stop is latched."""
    cause: Cause | None
    """The cause of the latched stop; None if no stop is latched. After several stops since the last reset, it is the
    cause of the first one."""
    blocked: str | None
    """Why the wheels may not turn, in the gate's words. None if they may turn. Programs should use `block`, which has
    fixed values."""
    body_vel: Velocity
    """The velocity that the gate commands."""
    wheels_radps: Wheels
    """The speed that the gate commands for each wheel."""
    epoch: int
    """A number that gets higher with every stop."""
    waiting_for: str | None
    """What is not ready yet, for example the board. Until it is ready, motion can't be enabled. None if everything is
    ready."""
    device: Device
    """The port of the board."""
    processes: dict[str, Process]
    """The processes by name."""
    starved: Starved | None
    """The longest time for which the machine was too busy to run a process of the service. None if the machine has run
    every process in time during the last ten minutes."""
    clients: tuple[Client, ...]
    """The programs that hold client slots."""
    sources: tuple[Source, ...]
    """The sources whose last command has not expired. A source with the state "silent" (see `Source`) is also listed.
    The source with the highest priority comes first."""
    scan_age_s: float | None
    """The time since the obstacle sensor last delivered a reading, in s. None if it never has."""
    last_stop: Stop | None
    """The last stop in this run. None if there was none."""
    imu: Imu | None
    """The newest sample of the IMU. None if there was none yet."""
    gyro_bias: GyroBias | None
    """The bias of the gyro. None until it is known."""
    odometry: Odometry | None
    """The newest odometry. None if there was none yet."""
    pad_mode: PadMode | None
    """What the gamepad moves. None if no frame of a gamepad was received yet."""
    battery_v: float | None
    """The battery's voltage, V. None if it was not read yet, if the board reports no battery, or if the board reports
    an impossible voltage."""
    plugged: Literal["unknown", "plugged", "unplugged"]
    """Whether a charger is plugged in: plugged, unplugged or unknown. failstop judges this by jumps of the battery's
    voltage. It is unknown until the first such jump."""
    age_s: float
    """The age of the gate's record, in s. The gate publishes at least every 0.08 s."""
    speed_limit: float = 1.0
    """The share of the speeds in the settings that drivers may use (`Robot.limit_speed`)."""
    attended_by: tuple[str, ...] | None = None
    """The operators who are present. None if the robot needs no operator (setting attend.required)."""
    arm: ArmState | None = None
    """The state of the arm. None if the settings have no arm, or if the service is just starting and the gate has not
    reported the arm yet."""
    unmet: str = ""
    """Why an interlock does not hold, as a text. Empty if all interlocks in the settings hold."""
    starved_times: int = 0
    """How many times in this run the machine was too busy to run a process of the service (see `starved`)."""
    lease_s: float = 0.06
    """How long the gate or the supervisor may be silent while the wheels turn, in s. After a longer silence, the robot
    is stopped. This is the setting gate.lease_s. Its default is longer if the service has no real-time rights."""
    steering_rad: float | None = None
    """The commanded angle of the steered wheels, rad, positive to the left. None if the robot has no steering or is at
    rest."""
    stands_within_m: float = 0.0
    """The stopping distance at the present speed limit, in m. After any fault that failstop can detect, the robot is at
    rest within this distance."""
    scale: Scale = Scale()
    """How fast the wheels turn, compared with how fast they are commanded to turn."""
    turning: Turning = Turning()
    """What is known about the wheels at present. It comes from observation, not from what was commanded."""
    enabled_ns: int = 0
    """When motion was enabled (CLOCK_MONOTONIC, ns); 0 while motion is disabled. If two snapshots have different times
    (and neither is 0), motion was disabled between them."""
    servos: dict[str, tuple[float, int]] = dataclasses.field(default_factory=dict)
    """For each servo, its load and its temperature in degrees C. The keys name the part that the servo turns, such as a
    wheel. The load is a signed share of the servo's largest load."""
    servos_wrong: dict[str, str] = dataclasses.field(default_factory=dict)
    """For each servo that does not answer or reports an error, what is wrong with it. The keys name the part that the
    servo turns, such as a wheel."""
    ages: Ages = Ages()
    """The ages of the newest readings."""
    battery_ns: int = 0
    """When `battery_v` was read (CLOCK_MONOTONIC, ns); 0 if it was never read."""
    run: str = ""
    """The run of the service. After a restart of the service it is another text, even in a container, where the pids
    are the same as before."""

    @property
    def block(self) -> Block | None:
        """Why the wheels may not turn. None if they may turn."""
        return Block.of(self.blocked)

    @property
    def moving(self) -> bool:
        """True while the gate commands a velocity."""
        return self.blocked is None and any(self.wheels_radps)

    def source_that(self, state: str) -> Source | None:
        """The source with the highest priority in this state (drives, waits, held or silent), or None."""
        return next((source for source in self.sources if source.state == state), None)

    def is_current(self, age_s: float | None) -> bool:
        """True if a reading of this age describes the present: it is fresh, the port is open, and the board still sends
        something."""
        heard = self.device.state == "open" and self.device.link not in (LINK_SILENT, LINK_UNHEARD)
        return heard and (age_s or 0.0) < OLD_S

    @property
    def driver(self) -> Source | None:
        """The source whose commands count at present, even if they command zero. None if no source drives."""
        return self.source_that("drives")

    def as_dict(self) -> dict[str, Any]:
        """The state as plain values, as `failstop status --json` prints it."""
        found = dataclasses.asdict(dataclasses.replace(self, cause=None, last_stop=None))
        found |= {"imu": self.imu and self.imu._asdict(), "odometry": self.odometry and self.odometry._asdict()}
        stop = self.last_stop and {**vars(self.last_stop), "cause": self.last_stop.cause.as_map()}
        return {**found, "cause": self.cause and self.cause.as_map(), "last_stop": stop}

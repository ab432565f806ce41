"""Wire: the vocabulary in which any motor board can be described. Each folder in failstop/board uses it to describe one
board.

described.py turns such a description into the Board that the service drives (docs/boards.md).
"""

from __future__ import annotations

from failstop.board.checks import counted, number
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from failstop.board.driver import DriverLanguage
    from failstop.board.facts import SteeringServo
    from failstop.board.interface import ServoBus, SteeringFrames

VOCABULARY = 1
"""The version of this vocabulary. Raise it if you change the vocabulary and failstop then refuses a description that
was valid before, or such a description gets another meaning."""

ZERO = "zero"
"""The value of Watchdog.does for a watchdog that brakes the wheels to rest."""
COAST = "coast"
"""The value of Watchdog.does for a watchdog that cuts the motors' current, so that the wheels roll on."""
DISARM = "disarm"
"""The value of Watchdog.does for a watchdog that stops the wheels. After it has acted, the board accepts no motion
until the board is armed again."""

WRITTEN = "written"
ANSWERED = "answered"
"""The proof that the board has parsed a stop: it has answered a question that was written after the stop."""
ECHOED = "echoed"
"""The proof that the board obeys a stop: it reports that its present command is zero."""
OBSERVED = "observed"
"""The proof that the wheels are at rest: the board's own reports of the wheels' speeds or positions show this. If a
board can't give this proof, failstop may still see from an IMU that the robot is at rest."""

MOST_REPEATS = 32
"""How many times each writer may write a stop: the most times in a row of TimedStop.repeats_ns."""

BITS_PER_BYTE = 10
"""How many bits one byte takes on the serial line: a start bit, eight data bits and a stop bit."""


class Port(Data):
    """How the board's serial port is set up, and what the board needs after the port was opened."""

    baud: int
    dtr: bool
    rts: bool
    deaf_ns: int
    """How long the board hears nothing after the port was opened, in ns. This may be long if opening the port resets
    the board. 0 if the board hears at once."""
    opening: tuple[bytes, ...]
    """Frames to write as soon as the board hears, for example the one that sets the board's own watchdog."""

    def at(self, baud: int) -> Port:
        """Return a copy of this port that has another baud rate."""
        return Port(baud=baud, dtr=self.dtr, rts=self.rts, deaf_ns=self.deaf_ns, opening=self.opening)

    @property
    def byte_ns(self) -> int:
        """How long one byte takes on the serial line, in ns."""
        return BITS_PER_BYTE * 1_000_000_000 // self.baud


class Write(Data):
    """One write to the port."""

    idle_ns: int
    """How long the line must be silent before the first byte of this write, in ns."""
    data: bytes


class TimedStop(Data):
    """How failstop stops the wheels: the bytes that it writes, and when it repeats them. In every state of the board's
    receiver, the first write or a repeat must stop the wheels."""

    writes: tuple[Write, ...]
    after_ns: int
    """How long the line must be silent after the last byte of the stop, in ns."""
    repeats_ns: tuple[tuple[int, ...], ...]
    """The times at which each writer writes the stop, in ns after its first stop. The first row is for the port owner,
    the second for the stopper and the third for the supervisor. A row begins with 0, which is the first stop, and then
    has the times of the repeats. The writers can't see each other's bytes, so their stops may touch on the line.
    Some boards drop two stops that touch. For such a board, give each row different times. If the stops of two writers
    touch, the next stops of these writers then don't touch. Also let the last time of each row be above 0.3 s, because
    an adapter may stall for that long. It then sends all the stops that it has kept, without gaps."""


class Pace(Data):
    """When frames other than stops may be written."""

    idle_ns: int
    """How long the line must be silent before a frame other than a stop, in ns. Even if this is 0, such a frame waits
    until the line has sent everything before it."""
    unanswered: int | None
    """How many frames may wait for the board's answer at the same time. None means any number."""


class Watchdog(Data):
    """The board's own watchdog. It stops the wheels when the computer falls silent, for example because its kernel
    crashed or the cable was pulled."""

    after_ns: int
    """How long after the last motion the watchdog acts, in ns, if nobody has set its time since the board started. 0
    means that it does not act until its time is set (set_ns)."""
    does: str
    """What the watchdog does to the wheels: ZERO, COAST or DISARM."""
    arm: Callable[[int], bytes] | None
    """A function (after_ns) that returns the frame which sets the watchdog's time. It raises FrameError for a time that
    the board can't have. None if the firmware's time is fixed."""
    set_ns: int
    """The time that failstop sets, in ns. 0 means that failstop leaves the board's own time unchanged."""
    fed_by: str
    """A sentence for people: which frames keep the watchdog from acting, and which frames don't."""

    @property
    def acts_ns(self) -> int:
        """How long after the last motion the watchdog acts while the service runs, in ns. 0 without a watchdog."""
        return self.set_ns or self.after_ns


NO_WATCHDOG = Watchdog(
    after_ns=0, does=ZERO, arm=None, set_ns=0, fed_by="it has none: it keeps its last speed for ever"
)
"""The value of Wire.watchdog for a board that has no watchdog of its own."""


class Motion(Data):
    """How speeds become motion frames. All these speeds are in the board's own unit."""

    wheels: int
    """How many speeds a frame has: two (left and right), three or four. Only the VESC of a steered base has one speed;
    your own board can't."""
    unit: str
    limit: float
    """The largest speed that the board accepts."""
    per_rps: Callable[[float], float]
    """A function (wheel diameter in m) that returns how many of the board's speed units usually make one wheel turn per
    second."""
    step: float
    """Speeds are rounded towards zero to a multiple of this number."""
    apart: float
    """The largest difference between two wheels' speeds that the board accepts."""
    frame: Callable[[Sequence[float], float], bytes]
    """A function (speeds, limit) that returns the frame which sets all wheels. It raises FrameError unless each speed
    is within plus or minus `limit`. For zeros it always returns exactly `rest`."""
    rest: bytes
    """The frame that sets every speed to zero."""
    check: Callable[[bytes, float], str]
    """A function (frame, limit) that says why these bytes must not be written as a motion frame. It returns "" if they
    may be written. It never raises on bytes."""
    speeds: Callable[[bytes], Sequence[float] | None]
    """A function (frame) that returns the speeds which a motion frame sets, or None for other bytes. It never raises on
    bytes."""
    marked: Callable[[bytes, int], bytes] | None = None
    """A function (frame, turn) for a board that has no questions. `turn` says how many times failstop has sent the same
    motion again. Depending on `turn`, the function returns the motion frame unchanged or a few steps slower. So the
    frames differ while the motion stays the same, and the board's report of its present command shows which of the
    frames the board has received."""
    scale_known: bool = False
    """True if the board itself fixes the result of `per_rps`, so it is the same for every robot. False if it depends on
    the robot's motors and encoders, so it is only a guess until somebody confirms it by turning a wheel
    (board.per_rps_confirmed)."""


class Sample:
    """Something that the board reports. The classes below are all kinds of samples, for every board."""


class Wheels(Sample, Data):
    """A report about the wheels, with values for left and right, or for each wheel. `speeds` or `positions` is empty if
    the board does not report it."""

    speeds: tuple[float, ...]
    """The wheels' speeds. Reports.speed_per_rps defines their unit. If the description has no Reports, the unit is that
    of the board's motion frames."""
    positions: tuple[float, ...]
    """The wheels' odometers, in the board's own unit. Two equal reports in a row prove that the wheels are at rest."""


class Obeyed(Sample, Data):
    """A report of the command that the board follows at the moment, in the unit of its motion. It is all zeros after a
    stop, and also after the board's own watchdog has acted."""

    speeds: tuple[float, ...]


class Battery(Sample, Data):
    """A report of the battery's voltage."""

    volts: float


SERVO_VOLTAGE, SERVO_SENSOR, SERVO_HEAT, SERVO_CURRENT, SERVO_LOAD, SERVO_OTHER, SERVO_MISSING = 1, 2, 4, 8, 32, 64, 128
"""What can be wrong with a servo, one bit for each fault. SERVO_OTHER is a fault that has no bit of its own.
SERVO_MISSING means that this servo does not answer while others do."""


class Health(Sample, Data):
    """What servos report about themselves. Each row has a servo's id, load, temperature in degrees Celsius, and faults.
    A load of 1 is the most that the servo can give. The load is negative in the other direction. A temperature of 0 was
    not reported yet. The faults are a sum of bits such as SERVO_VOLTAGE, and may be left out."""

    rows: tuple[tuple[int, float, int] | tuple[int, float, int, int], ...]


class Imu(Sample, Data):
    """A report of an IMU: acceleration in m/s^2 and turn rate in rad/s, along the board's axes."""

    accel: tuple[float, float, float]
    gyro: tuple[float, float, float]


class Answer(Sample, Data):
    """A line or frame that the board sends only when asked. It proves that the board hears, and contains no other
    report."""

    text: str


class Restarted(Sample, Data):
    """A sign that the board, or a part of it such as a motor's own controller, has restarted."""

    text: str
    """What the sign was, in words for people, for example "it printed its boot text"."""


class Firmware(Sample, Data):
    """A sign that the board's firmware is not the usual one."""

    name: str
    """A text for people: whose firmware it is, how failstop recognised it, and what to check before you use it."""


class Question(Data):
    """A frame that the board answers, and that moves nothing."""

    name: str
    ask: bytes
    answered_by: Callable[[Sample], bool]
    """A function (sample) that returns True if the sample is the answer to this question."""


def answer_is(*texts: str) -> Callable[[Sample], bool]:
    """Make the `answered_by` of a question whose answer is an Answer with exactly one of these texts."""
    return lambda sample: isinstance(sample, Answer) and sample.text in texts


class Reader:
    """Turns the board's bytes into samples. Keeps the bytes of an incomplete sample until the rest comes."""

    def feed(self, chunk: bytes) -> list[Sample]:
        """Return the samples that these bytes complete, in order. Never raises."""
        raise NotImplementedError


class Commander(Data):
    """Another program, device or person that can command the wheels without failstop."""

    who: str
    """A text for people: who or what this is, and how it can send commands."""
    remedy: str
    """A text for people: how to prevent such commands."""
    program: str = ""
    """A part of the command line by which failstop finds this program among those that run on the robot's computer.
    Empty if the commander is not such a program."""
    fix: str = ""
    """The command that ends the program and keeps it from starting again. Empty if it does not start again by
    itself."""


class Reports(Data):
    """How to read the board's reports about its wheels (`Wheels`)."""

    every_ns: int
    """The longest time between two reports of a healthy board while the service runs, in ns."""
    speed_per_rps: Callable[[float, float], float] | None
    """A function (per_rps, wheel diameter in m) that returns how many units of the reported speeds make one wheel turn
    per second. `per_rps` is the same number for the commanded speeds. None if the board reports no speeds."""
    position_per_turn: Callable[[float, float], float] | None
    """A function (per_rps, wheel diameter in m) that returns how much a position grows in one turn of its wheel. None
    if the board reports no positions."""
    wraps: float
    """The size of the range of the positions, which goes from minus half of this to plus half of this. Beyond one end,
    positions continue at the other end. 0 means that positions never wrap around."""
    holds_speed: bool
    """True if the board measures the speed of each wheel and holds the commanded one. False if it only sets a voltage,
    so a wheel may turn faster downhill and slower uphill."""
    own_scale: bool
    """True if the board reports in a real-world unit, so its reports reveal a wrong setting board.per_rps. False if
    failstop uses this setting for both commands and reports, so that an error in it does not show."""
    position_step: float = 0.0
    """The board rounds positions towards zero to a multiple of this number. 0 means that its positions are so fine that
    this does not matter."""


class Wire(Data):
    """The whole description of one board: how to open its port, how to stop and drive it, and how to read it."""

    name: str
    """The name of the board for people, for example "an Arduino with ros_arduino_bridge"."""
    port: Port
    stop: TimedStop
    pace: Pace
    watchdog: Watchdog
    motion: Motion
    questions: tuple[Question, ...]
    reader: Callable[[], Reader]
    proofs: tuple[str, ...]
    """The proofs of a stop that the board can give: ANSWERED, ECHOED, OBSERVED. WRITTEN is not listed, because it needs
    nothing from the board."""
    ping_ns: int
    """The longest time that may pass between two questions, in ns. With a longer time, the board would give its proofs
    of a stop too late. 0 means that any time will do."""
    echo_ns: int
    """The longest time from the write of a command to the board's report that it obeys this command, in ns. 0 if the
    board makes no such reports."""
    other_bauds: tuple[int, ...] = ()
    """Other baud rates with which the board's firmware is often built. `failstop doctor` and `failstop setup` try these
    after the rate of `port`."""
    usb: tuple[str, ...] = ()
    """The board's own USB ports as vendor:product in hexadecimal, for example "2341:0043". Don't list the chip of a
    separate USB adapter, because it says nothing about the board behind the adapter."""
    silent_ns: int = 0
    """How long the board's reports about its wheels must pause before the board counts as restarted, in ns. It makes no
    difference whether the reports come unasked or as answers. Choose a longer time than the pause that one garbled
    report would cause. 0 if the board reports nothing."""
    commanders: tuple[Commander, ...] = ()
    reports: Reports | None = None
    """How to read the board's reports about its wheels. If this is None, the reported speeds have the unit of the
    board's motion frames, and reported positions only show whether the wheels are at rest."""
    arm: Callable[[Port], ServoBus] | None = None
    """A function (port) that makes the object which talks to an arm's servos on this port. None if the board has no
    arm."""
    steering: Callable[[SteeringServo], SteeringFrames] | None = None
    """A function (steering servo from the settings) that returns an object which makes and checks the frames for this
    servo. None if the board can't turn a steering servo."""
    aux: Callable[[bytes], str] | None = None
    """A function (frame) that checks an extra frame, for example one for a light. It returns why the frame must not be
    written, or "" if it may be written. An extra frame that it accepts must move nothing, even if the frame is cut
    short, and may delay the next frame by 30 ms at most. None if the board gets no extra frames."""
    driver: Callable[[Mapping[str, float | str]], DriverLanguage] | None = None
    """A function (all settings by their full keys) that returns an object which reads what a driver program writes to
    the guard port (DriverLanguage in driver.py). The class of this object is in a module that no process of the service
    needs. So import this module inside the function. None if nobody has described this for the board."""


def two_speeds(speeds: Sequence[float], limit: float, most: float, unit: str) -> tuple[float, float]:
    """Return the speeds of the left and the right wheel. Raises FrameError unless both are finite numbers within plus
    or minus `limit`, and `limit` is from 0 to `most`."""
    counted("speeds", speeds, 2, 2)
    number("limit", limit, 0.0, most, unit)
    return number("speed left", speeds[0], -limit, limit, unit), number("speed right", speeds[1], -limit, limit, unit)


def beyond(speeds: Sequence[float], limit: float, most: float) -> str:
    """Return the reason to refuse these speeds, or "" to accept them. Each must be within plus or minus `limit`, and
    `limit` must be from 0 to `most`."""
    if not 0.0 <= limit <= most:
        return f"limit {limit}, must be 0 to {most:g}"
    names = ("left", "right") if len(speeds) == 2 else range(len(speeds))
    for name, speed in zip(names, speeds, strict=True):
        if not -limit <= speed <= limit:  # a chained comparison is false for NaN
            return f"{name} at {speed:g}, limit {limit:g}"
    return ""

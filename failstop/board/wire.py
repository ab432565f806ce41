"""Wire: the vocabulary in which any motor board can be described. Each folder in failstop/board describes one board
with it.

described.py turns a description into the Board that the service drives (docs/boards.md).
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
"""The number of this vocabulary. It is raised when a description that was valid would be refused, or mean something
else."""

ZERO = "zero"
"""The wheels are braked to rest."""
COAST = "coast"
"""The motors get no current, and the wheels roll on."""
DISARM = "disarm"
"""The wheels stop, and the board takes no motion until it is armed again."""

WRITTEN = "written"
ANSWERED = "answered"
"""Proof: a question after the stop was answered, so the stop was parsed."""
ECHOED = "echoed"
"""Proof: the board reports the command that it obeys, and that is zero."""
OBSERVED = "observed"
"""Proof: the board's reports about its wheels' speeds or positions show that they are at rest. Without them an IMU
may."""

BITS_PER_BYTE = 10
"""On the wire: a start bit, eight data bits and a stop bit."""


class Port(Data):
    """How the board's serial port is set up, and how long the board is deaf while it starts."""

    baud: int
    dtr: bool
    rts: bool
    deaf_ns: int
    """How long the board hears nothing after the port was opened, because opening resets it, ns."""
    opening: tuple[bytes, ...]
    """Frames to write as soon as the board hears. They set its own watchdog."""

    def at(self, baud: int) -> Port:
        """The same port with another baud rate."""
        return Port(baud=baud, dtr=self.dtr, rts=self.rts, deaf_ns=self.deaf_ns, opening=self.opening)

    @property
    def byte_ns(self) -> int:
        """How long one byte takes on the wire, ns."""
        return BITS_PER_BYTE * 1_000_000_000 // self.baud


class Write(Data):
    """One write to the port."""

    idle_ns: int
    """How long the line must be silent before its first byte."""
    data: bytes


class TimedStop(Data):
    """Writes that stop the wheels whatever state the board's receiver is in."""

    writes: tuple[Write, ...]
    after_ns: int
    """How long the line must be silent after its last byte."""
    repeats_ns: tuple[tuple[int, ...], ...]
    """A row for each writer: when it repeats the stop, after it began. Writers that can't see each other's bytes have
    different times, so that no two touch twice in a row. If stops may not touch, the last repeats come after 0.3 s: an
    adapter that stalls sends everything it kept at once, and such a board drops that."""


class Pace(Data):
    """When anything other than a stop may be written."""

    idle_ns: int
    """How long the line must be silent before it."""
    unanswered: int | None
    """How many frames may be unanswered at a time; None: any number."""


class Watchdog(Data):
    """The board's own watchdog, which stops the wheels when the host is gone: a dead kernel, a pulled cable."""

    after_ns: int
    """After how long it acts when the board has just started."""
    does: str
    """ZERO, COAST or DISARM."""
    arm: Callable[[int], bytes] | None
    """(after_ns): the frame that sets the time; raises FrameError. None if the firmware's time is fixed."""
    set_ns: int
    """The time that failstop sets at each opening; 0: unchanged."""
    fed_by: str
    """A sentence for people: what keeps it from acting, and what does not."""

    @property
    def acts_ns(self) -> int:
        """How long after the last motion it acts in a running service; 0 if it has none."""
        return self.set_ns or self.after_ns


NO_WATCHDOG = Watchdog(
    after_ns=0, does=ZERO, arm=None, set_ns=0, fed_by="it has none: it keeps its last speed for ever"
)
"""For a board without a watchdog."""


class Motion(Data):
    """How speeds become motion, in the board's own unit."""

    wheels: int
    """How many speeds a frame has: one (of a steered base), two (left and right), three or four."""
    unit: str
    limit: float
    """The largest speed that the board takes."""
    per_rps: Callable[[float], float]
    """(wheel diameter in m): one turn per second of a wheel in the board's unit, as it usually is."""
    step: float
    """Speeds are sent as multiples of this, truncated towards zero."""
    apart: float
    """The largest difference between two wheels that the board accepts."""
    frame: Callable[[Sequence[float], float], bytes]
    """(speeds, limit): the frame that sets all wheels, each within plus or minus `limit`. Raises FrameError. Zeros
    always make exactly `rest`."""
    rest: bytes
    """The frame for zeros."""
    check: Callable[[bytes, float], str]
    """(frame, limit): why these bytes must not be written as a motion frame; "" if they may. Never raises on bytes."""
    speeds: Callable[[bytes], Sequence[float] | None]
    """The speeds that a motion frame sets; None for other bytes. Never raises on bytes."""
    marked: Callable[[bytes, int], bytes] | None = None
    """(frame, turn): a motion frame that is sent again, made a step or two slower depending on its turn, so that the
    board's report of the obeyed command shows which frame it was. Only a board without questions needs it."""
    scale_known: bool = False
    """True: `per_rps` is a fact of the board, the same for every robot. False: it depends on the robot's motors and
    encoders, so `per_rps` is only a guess until a turn of a wheel has confirmed it (board.per_rps_confirmed)."""


class Sample:
    """A report, in the same few kinds for all boards."""


class Wheels(Sample, Data):
    """The wheels: left and right, or each one. If a board does not report a kind of value, it is empty."""

    speeds: tuple[float, ...]
    """In the unit of its motion."""
    positions: tuple[float, ...]
    """Odometers, in the board's own unit. Two equal reports prove that the wheels are at rest."""


class Obeyed(Sample, Data):
    """The command that the board follows now, in the unit of its motion; zeros also after its watchdog has acted."""

    speeds: tuple[float, ...]


class Battery(Sample, Data):
    """The battery's voltage."""

    volts: float


SERVO_VOLTAGE, SERVO_SENSOR, SERVO_HEAT, SERVO_CURRENT, SERVO_LOAD, SERVO_MISSING = 1, 2, 4, 8, 32, 128
"""What is wrong with a servo, as bits. SERVO_MISSING: it answers nothing while others do."""


class Health(Sample, Data):
    """What servos report about themselves: the id, load (a share of the most that the servo gives, negative in the
    other direction) and temperature of each in degrees Celsius (0: not reported yet), and what is wrong with it
    (SERVO_VOLTAGE and the others; may be left out)."""

    rows: tuple[tuple[int, float, int] | tuple[int, float, int, int], ...]


class Imu(Sample, Data):
    """Acceleration in m/s^2 and turn rate in rad/s, along the board's axes."""

    accel: tuple[float, float, float]
    gyro: tuple[float, float, float]


class Answer(Sample, Data):
    """A line that is only an answer, and comes only after a question."""

    text: str


class Restarted(Sample, Data):
    """A sign that the board, or a part of it such as a motor's own controller, has started again."""

    text: str
    """For people, for example "it printed its boot text"."""


class Firmware(Sample, Data):
    """A firmware, recognised by its reports, that differs from the usual one."""

    name: str
    """For people: whose firmware it is, how it was recognised, and what to check with it."""


class Question(Data):
    """A frame that moves nothing and is answered."""

    name: str
    ask: bytes
    answered_by: Callable[[Sample], bool]
    """Whether a sample is the answer to it."""


def answer_is(text: str) -> Callable[[Sample], bool]:
    """Use this for a question if its answer is an Answer with exactly this text."""
    return lambda sample: isinstance(sample, Answer) and sample.text == text


class Reader:
    """Takes bytes from the board, and returns samples. It keeps incomplete ones."""

    def feed(self, chunk: bytes) -> list[Sample]:
        """The samples that these bytes complete, in order. Never raises."""
        raise NotImplementedError


class Commander(Data):
    """Another program, device or person, besides failstop, that can command the wheels."""

    who: str
    """For people: what or who it is, and how it can send commands."""
    remedy: str
    """For people: how to prevent it."""
    program: str = ""
    """A part of the command line of that program on the host. Empty if it is not a program, so that nothing on the host
    shows it."""
    fix: str = ""
    """The command that ends the program for good, if it would be restarted otherwise."""


class Reports(Data):
    """How to read the board's reports about its wheels (`Wheels`)."""

    every_ns: int
    """The longest time between two reports of a healthy board in a running service."""
    speed_per_rps: Callable[[float, float], float] | None
    """(one turn per second in the unit of its motion, wheel diameter in m): one turn per second in the unit of the
    reported speeds. None if it reports no speeds."""
    position_per_turn: Callable[[float, float], float] | None
    """The same arguments: how much a position grows in one turn of its wheel. None if it reports no positions."""
    wraps: float
    """Positions are counted modulo this, from minus half of it; 0: they never wrap."""
    holds_speed: bool
    """True: the board measures the speed and holds the commanded one. False: it sets a voltage, so a wheel may turn
    faster downhill and slower uphill."""
    own_scale: bool
    """True: the board reports in a real-world unit, so a wrong setting board.per_rps shows. False: commands and reports
    share that setting."""
    position_step: float = 0.0
    """Positions are whole multiples of this, truncated towards zero; 0: too fine to matter."""


class Wire(Data):
    """Everything about one board's language."""

    name: str
    """For people: the name of the board, such as "an Arduino with ..."."""
    port: Port
    stop: TimedStop
    pace: Pace
    watchdog: Watchdog
    motion: Motion
    questions: tuple[Question, ...]
    reader: Callable[[], Reader]
    proofs: tuple[str, ...]
    """The proofs of a stop that it can give besides WRITTEN: ANSWERED, ECHOED, OBSERVED."""
    ping_ns: int
    """The longest time between two questions, if the proofs need them; 0: any."""
    echo_ns: int
    """When it reports that it obeys zeros, the command was written at least this long before; 0: it does not report
    it."""
    other_bauds: tuple[int, ...] = ()
    """Baud rates that its firmware is often built with, besides that of `port`: doctor and setup try these too."""
    usb: tuple[str, ...] = ()
    """Vendor:product, in hexadecimal, of the board's own USB ports; an adapter's say nothing about the board behind
    it."""
    silent_ns: int = 0
    """Its reports about its wheels, unasked or as answers, never pause for this long unless it restarts. One report
    that is garbled on the line must not be enough for such a pause. 0: it reports nothing."""
    commanders: tuple[Commander, ...] = ()
    reports: Reports | None = None
    """None: reported speeds are in the unit of its motion, and positions only show rest."""
    arm: Callable[[Port], ServoBus] | None = None
    """Makes the part that talks to an arm's servos on this port. None if the board has no arm."""
    steering: Callable[[SteeringServo], SteeringFrames] | None = None
    """Makes the frames that turn the servo of a steered base. None if the board can turn none."""
    aux: Callable[[bytes], str] | None = None
    """(frame): why a frame that is neither motion nor a stop nor a question must not be written; "" if it may. It must
    move nothing, whole or cut off, and keep the board from its next frame for 30 ms at most. None: no such frame is
    written."""
    driver: Callable[[Mapping[str, float | str]], DriverLanguage] | None = None
    """(every setting by its full key): what a driver program may write to the board, for the guard port (driver.py).
    Import that module inside the function, because no process of the service needs it. None: not described."""


def two_speeds(speeds: Sequence[float], limit: float, most: float, unit: str) -> tuple[float, float]:
    """Left and right, each a finite number within plus or minus `limit`, which is `most` at most; else FrameError."""
    counted("speeds", speeds, 2, 2)
    number("limit", limit, 0.0, most, unit)
    return number("speed left", speeds[0], -limit, limit, unit), number("speed right", speeds[1], -limit, limit, unit)


def beyond(speeds: Sequence[float], limit: float, most: float) -> str:
    """Why these speeds must not be commanded; "" if they may."""
    if not 0.0 <= limit <= most:
        return f"limit {limit}, must be 0 to {most:g}"
    names = ("left", "right") if len(speeds) == 2 else range(len(speeds))
    for name, speed in zip(names, speeds, strict=True):
        if not -limit <= speed <= limit:  # a chained comparison is false for NaN
            return f"{name} at {speed:g}, limit {limit:g}"
    return ""

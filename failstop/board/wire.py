"""Wire: the vocabulary in which any motor board is described; one folder of this room describes one board with it.

described.py makes of it what the service drives (docs/boards.md).
"""

from __future__ import annotations

from failstop.board.checks import counted, number
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from failstop.board.driver import DriverLanguage
    from failstop.board.interface import ServoBus

VOCABULARY = 1
"""The number of this vocabulary. It is raised when a description that held would be refused, or mean another thing."""

ZERO = "zero"
"""The wheels are driven to rest."""
COAST = "coast"
"""The motors get no current, and the wheels roll on."""
DISARM = "disarm"
"""The wheels stop, and the board takes no motion before it was armed again."""

WRITTEN = "written"
ANSWERED = "answered"
"""Proof: a question behind the stop was answered, so the stop was parsed."""
ECHOED = "echoed"
"""Proof: the board reports the command that it obeys, and that is zero."""
OBSERVED = "observed"
"""Proof: the board's reports of its wheels' speeds or positions say that they stand; without it an IMU may."""

BITS_PER_BYTE = 10
"""On the wire: a start bit, eight of data, a stop bit."""


class Port(Data):
    """How the board's serial port is set up, and what is lost while the board starts."""

    baud: int
    dtr: bool
    rts: bool
    deaf_ns: int
    """How long after it was opened nothing is heard: opening resets the board."""
    opening: tuple[bytes, ...]
    """Frames to write when it hears: they arm its own watchdog."""

    @property
    def byte_ns(self) -> int:
        """How long a byte takes on the wire."""
        return BITS_PER_BYTE * 1_000_000_000 // self.baud


class Write(Data):
    """One write to the port."""

    idle_ns: int
    """How long the line has to be silent before its first byte."""
    data: bytes


class TimedStop(Data):
    """Writes that stop the wheels whatever state the board's receiver is in."""

    writes: tuple[Write, ...]
    after_ns: int
    """How long the line has to be silent after its last byte."""
    repeats_ns: tuple[tuple[int, ...], ...]
    """A row for each writer: when it writes the stop, after it began. Writers that can't see each other's bytes have
    different times, so that no two of them touch twice in a row. Where stops may not touch, the last repeats come after
    0.3 s: an adapter that stalls sends everything it kept in one lump, and such a board drops the lump."""


class Pace(Data):
    """When anything but a stop may be written."""

    idle_ns: int
    """How long the line has to be silent before it."""
    unanswered: int | None
    """How many frames may be on their way without the answer to them; None: any number."""


class Watchdog(Data):
    """The board's own watchdog, which stops the wheels when the host is gone: a dead kernel, a pulled cable."""

    after_ns: int
    """As the board comes up."""
    does: str
    """ZERO, COAST or DISARM."""
    arm: Callable[[int], bytes] | None
    """(after_ns): the frame that sets the time; raises FrameError. None: it is what the firmware was built with."""
    set_ns: int
    """The time that failstop sets at each opening; 0: it stays as it is."""
    fed_by: str
    """A sentence for people: what keeps it from acting, and what does not."""

    @property
    def acts_ns(self) -> int:
        """How long after the last motion it acts in a service of failstop; 0: it has none."""
        return self.set_ns or self.after_ns


NO_WATCHDOG = Watchdog(
    after_ns=0, does=ZERO, arm=None, set_ns=0, fed_by="it has none: it keeps its last speed for ever"
)
"""Of a board without one."""


class Motion(Data):
    """Motion from the speeds of the wheels, in the board's own unit."""

    wheels: int
    """How many speeds there are: two (left and right), three or four."""
    unit: str
    limit: float
    """The largest speed that the board takes."""
    per_rps: Callable[[float], float]
    """(diameter in m): what one turn a second of a wheel usually is in its unit."""
    step: float
    """Speeds are sent as multiples of this, rounded towards zero."""
    apart: float
    """The largest difference between two wheels that the board takes."""
    frame: Callable[[Sequence[float], float], bytes]
    """(speeds, limit): the frame that sets all wheels, each within plus or minus `limit`. Raises FrameError. Zeros make
    exactly one form, `rest`."""
    rest: bytes
    """The frame for zeros."""
    check: Callable[[bytes, float], str]
    """(frame, limit): why these bytes must not be written as a motion frame; "" when they may. Never raises on
    bytes."""
    speeds: Callable[[bytes], Sequence[float] | None]
    """Those that a motion frame sets; None for other bytes. Never raises on bytes."""
    marked: Callable[[bytes, int], bytes] | None = None
    """(frame, turn): a motion frame that is sent again, a step or two slower by its turn, so that the report of the
    command that the board obeys tells which frame it was. Only a board that is asked nothing needs it."""
    scale_known: bool = False
    """True: `per_rps` is a fact of the board, the same for every robot. False: it depends on the robot's motors and
    encoders, so `per_rps` is only a guess until a turn of a wheel has confirmed it (board.per_rps_confirmed)."""


class Sample:
    """A report of a board, in the same few kinds for all boards."""


class Wheels(Sample, Data):
    """Left and right, or one for each wheel; what a board does not report is empty."""

    speeds: tuple[float, ...]
    """In the unit of its motion."""
    positions: tuple[float, ...]
    """Odometers, in a unit of the board's own: two reports that are equal prove rest."""


class Obeyed(Sample, Data):
    """The command that the board follows now, in the unit of its motion; zeros also after its watchdog has acted."""

    speeds: tuple[float, ...]


class Battery(Sample, Data):
    """Its voltage."""

    volts: float


class Health(Sample, Data):
    """Servos, as they say of themselves: of each its id, its load (a share of the most that it gives, negative the
    other way round) and its temperature in degrees Celsius (0: not told yet)."""

    rows: tuple[tuple[int, float, int], ...]


class Imu(Sample, Data):
    """Acceleration in m/s^2 and turn rate in rad/s, by the axes of the board."""

    accel: tuple[float, float, float]
    gyro: tuple[float, float, float]


class Answer(Sample, Data):
    """A line that only answers, and is never sent unasked."""

    text: str


class Restarted(Sample, Data):
    """It prints this only while it starts."""

    text: str
    """For people, as "its boot text"."""


class Firmware(Sample, Data):
    """It is known by its reports as a firmware that differs from the usual one."""

    name: str
    """For people: whose it is, by what it is known, and what to look at with it."""


class Question(Data):
    """A frame that moves nothing and is answered."""

    name: str
    ask: bytes
    answered_by: Callable[[Sample], bool]
    """Whether a sample is the answer to it."""


class Reader:
    """Bytes from the board, in; samples, out. It keeps what is not complete yet."""

    def feed(self, chunk: bytes) -> list[Sample]:
        """The samples that these bytes complete, in order. Never raises."""
        raise NotImplementedError


class Commander(Data):
    """Somebody beside failstop who can command the wheels."""

    who: str
    """For people: who, and by which way."""
    remedy: str
    """For people: what keeps them from it."""
    program: str = ""
    """A part of the command line of a program on the host; empty: it is none, and nothing on the host shows it."""
    fix: str = ""
    """The command that ends that program, where it would be started again."""


class Reports(Data):
    """How to read what the board reports of its wheels (`Wheels`)."""

    every_ns: int
    """The longest time between two reports of a healthy board in a running service."""
    speed_per_rps: Callable[[float, float], float] | None
    """(one turn a second in the unit of its motion, wheel diameter in m): one turn a second in the unit of the reported
    speeds. None: it reports no speeds."""
    position_per_turn: Callable[[float, float], float] | None
    """The same arguments: how much a position grows in one turn of its wheel. None: it reports no positions."""
    wraps: float
    """Positions are counted modulo this, from minus half of it; 0: they never wrap."""
    holds_speed: bool
    """True: the board measures the speed and holds what it was told. False: it sets a voltage, so a wheel may turn
    faster downhill and slower uphill."""
    own_scale: bool
    """True: the board reports in a unit of the real world, so a wrong setting board.per_rps shows. False: commands and
    reports share that setting."""
    position_step: float = 0.0
    """Positions are whole multiples of this, cut towards zero; 0: too fine to matter."""


class Wire(Data):
    """Everything that is known of one board's language."""

    name: str
    """For people: which board it is, as "an Arduino with ..."."""
    port: Port
    stop: TimedStop
    pace: Pace
    watchdog: Watchdog
    motion: Motion
    questions: tuple[Question, ...]
    reader: Callable[[], Reader]
    proofs: tuple[str, ...]
    """Proofs of a stop that it can give beside WRITTEN: ANSWERED, ECHOED, OBSERVED."""
    ping_ns: int
    """The longest time between two questions, where the proofs need them; 0: any."""
    echo_ns: int
    """A command of zeros that it reports as obeyed was written this long before at least; 0: it reports none."""
    usb: tuple[str, ...] = ()
    """Vendor:product, in hexadecimal, of USB ports of its own; an adapter's say nothing of the board behind it."""
    silent_ns: int = 0
    """Its reports of its wheels, by itself or to questions, never pause for so long unless it restarts; one that is
    garbled on the line must not be enough. 0: it reports nothing."""
    commanders: tuple[Commander, ...] = ()
    reports: Reports | None = None
    """None: reported speeds are in the unit of its motion, and positions tell no more than rest."""
    arm: Callable[[Port], ServoBus] | None = None
    """Makes the part that speaks to an arm's servos on this port. None: the board has no arm."""
    driver: Callable[[Mapping[str, float | str]], DriverLanguage] | None = None
    """(every setting by its whole key): what a driver program may write to the board, for the guard port (driver.py).
    Import that module inside the function, because no process of the service needs it. None: nobody has said."""


def two_speeds(speeds: Sequence[float], limit: float, most: float, unit: str) -> tuple[float, float]:
    """Left and right, each a finite number within plus or minus `limit`, which is `most` at most; else FrameError."""
    counted("speeds", speeds, 2, 2)
    number("limit", limit, 0.0, most, unit)
    return number("speed left", speeds[0], -limit, limit, unit), number("speed right", speeds[1], -limit, limit, unit)


def beyond(speeds: Sequence[float], limit: float, most: float) -> str:
    """Why these speeds must not be commanded; "" when they may."""
    if not 0.0 <= limit <= most:
        return f"limit {limit}, must be 0 to {most:g}"
    names = ("left", "right") if len(speeds) == 2 else range(len(speeds))
    for name, speed in zip(names, speeds, strict=True):
        if not -limit <= speed <= limit:  # a chained comparison is false for NaN
            return f"{name} at {speed:g}, limit {limit:g}"
    return ""

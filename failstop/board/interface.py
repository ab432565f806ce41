"""Interface: everything that failstop needs from a motor board. Each process makes one Board when it starts.

described.py makes the Board from a description (wire.py). A board with a gamepad or keys has its own class, in the
board's folder. An arm is an optional part of a board (ServoBus).
"""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from typing import Any

    from failstop.board.wire import Commander, Port

    Value = tuple[Any, ...]
    Said = tuple[int, Value]
    """A report: its kind (one of the HEARD_ numbers) and its value."""

PORT_OWNER_ROW, STOPPER_ROW, SUPERVISOR_ROW = range(3)
"""The processes that write stops, each with its row in Board.repeats_ns. A program that writes a stop while no service
runs uses the last row."""
HEARD_IMU, HEARD_BATTERY, HEARD_PAD, HEARD_KEY, HEARD_SERVO, HEARD_PONG, HEARD_WHEELS, HEARD_OBEYED, HEARD_HEALTH = (
    range(9)
)
HEARD_ODD, HEARD_RESTARTED, HEARD_FIRMWARE = 9, 10, 11
"""The kinds of reports that a Hearing returns are these three, and HEARD_IMU to HEARD_HEALTH. Hearing says what each
kind contains."""
BUTTONS = {
    "L2": 0x0001,
    "R2": 0x0002,
    "SELECT": 0x0004,
    "START": 0x0008,
    "L3": 0x0020,
    "R3": 0x0040,
    "X": 0x0100,
    "O": 0x0200,
    "SQUARE": 0x0800,
    "TRIANGLE": 0x1000,
    "L1": 0x4000,
    "R1": 0x8000,
}
"""The buttons of a gamepad, one bit for each."""
BY_ANSWER, BY_ECHO = "answer", "echo"
"""What proves that the board has received a stop. BY_ANSWER: the board has answered a later ping. BY_ECHO: the board
reports the command that it obeys."""
BY_IMU, BY_WHEELS = "IMU", "wheels"
"""What proves that the wheels are at rest: the IMU, or the board's own reports of the wheels' speeds or positions."""


class WheelReports(Data):
    """How often one board's reports about the wheels (HEARD_WHEELS) come, and what their numbers mean on this robot."""

    every_ns: int
    """The longest time between two reports of a healthy board while the service runs, in ns. 0 if the board does not
    report its wheels."""
    speed_per_rps: float
    """How many units of the reported speeds make one turn per second. 0 if the board reports no speeds."""
    position_per_turn: float
    """How much a position grows in one turn of its wheel. 0 means that positions only show whether the wheel is at
    rest."""
    wraps: float
    """The size of the range in which positions wrap around. 0 means that they never wrap."""
    holds_speed: bool
    """True if the board measures the speed of each wheel and keeps it at the commanded speed. False if it only sets a
    voltage."""
    own_scale: bool
    """True if the reports do not depend on the setting board.per_rps, so they reveal a wrong value of this setting."""
    position_step: float = 0.0
    """Positions are rounded towards zero to a multiple of this number. 0 means that the steps are too small to
    matter."""
    apart_ns: int = 0
    """Two reports that are closer together than this, in ns, may have the same positions although a wheel turns."""

    @property
    def judged_ns(self) -> int:
        """The longest time between two reports that tell the speeds, in ns: positions that are too close together are
        not compared."""
        return self.every_ns + (0 if self.speed_per_rps else self.apart_ns)


UNKNOWN_EVERY_NS = 1_000_000_000
"""The value of `every_ns` for a board whose description does not say how often it reports."""
NO_WHEEL_REPORTS = WheelReports(0, 0.0, 0.0, 0.0, holds_speed=False, own_scale=False)


class Hearing:
    """Decodes the board's bytes into reports. Each report is a (kind, value):

    - HEARD_IMU: the acceleration x y z in g, then the turn rate x y z in degrees per second.
    - HEARD_BATTERY: the voltage in mV, or 0 if no battery is connected.
    - HEARD_PAD: the gamepad's buttons (the bits of BUTTONS), hat, lx, ly, rx, ry, and the raw frame.
    - HEARD_KEY: the key's id and the event.
    - HEARD_SERVO: the servo's id, the question and the answer.
    - HEARD_PONG: the indices of the pings that may have been answered.
    - HEARD_WHEELS: (speeds, positions). Each is empty if the board does not report it.
    - HEARD_OBEYED: the speeds of the command that the board follows at the moment.
    - HEARD_HEALTH: a row for each servo: its id, load (-1 to 1), temperature in degrees Celsius, and faults (the SERVO_
      bits of wire.py).
    - HEARD_ODD: the name of an impossible value, and the value as text. The value counts as not reported.
    - HEARD_RESTARTED: a text that says how the board showed that it restarted.
    - HEARD_FIRMWARE: the name of an unusual firmware. This report comes only once.
    """

    __slots__ = ()

    def feed(self, chunk: bytes) -> list[Said]:
        """Return all reports that these bytes complete, in order. Never raises."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget the bytes of an incomplete report, for example after the port was reopened."""
        raise NotImplementedError


class ServoBus:
    """Makes and checks the frames for an arm's servos. Servo ids are 1 to 253. Positions are in pulses (ArmFacts in
    facts.py). servos.py lists the questions for a servo. failstop makes frames for servos only if the settings have
    [joints]."""

    __slots__ = ()

    beside_wheels: bool
    """True if the arm may move while the wheels may turn. This needs a board on which a stop never has to wait for a
    servo."""
    holds_by_goal: bool
    """True if a servo keeps moving to its newest goal after a stop, because a stop does not change the goal. In a
    stream of moves the goal is only a few degrees ahead. If the servo has not reached the goal after the stream has
    ended, failstop makes the servo's measured position its new goal."""

    def stops(self, servos: Sequence[int]) -> bytes:
        """Return the frames that stop these servos. failstop writes them right after the stop burst, in the same write.
        Empty if a stop leaves the servos alone."""
        raise NotImplementedError

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """Return the frame that moves a few servos, each given as (id, pulses). The move takes `duration_ms`. If the
        frame for this duration would be dangerous if it was cut short, the move gets another duration, up to
        `longest_ms` (0 means servos.LONGEST_MOVE_MS). Raises FrameError."""
        raise NotImplementedError

    def read(self, servo: int, what: int) -> bytes:
        """Return the frame that asks a servo one of the questions in servos.READS. Raises FrameError."""
        raise NotImplementedError

    def look(self, servos: Sequence[int]) -> bytes:
        """Return the frame that asks a few servos for their positions at once, even while they move. Empty if the board
        has no such frame. Raises FrameError."""
        raise NotImplementedError

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """Return the frame that switches a servo's torque on or off. `at` is the servo's present position. A servo that
        remembers an old goal gets `at` as its new goal first, so it does not jump. Raises FrameError."""
        raise NotImplementedError

    def command(self, frame: bytes) -> int:
        """Return the command in a frame that has passed check(). servos.py has the list of commands."""
        raise NotImplementedError

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """Return the reason to refuse these bytes for an arm with these servos, or "" to accept them. It refuses
        anything that moves a wheel. Only questions may hold up the board's receiver for longer than servos.HELD_NS."""
        raise NotImplementedError

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """Return the moves in a frame: (id, pulses, duration in ns) for each servo. A duration of 0 means as fast as
        the servo can. Empty for other bytes. Never raises."""
        raise NotImplementedError

    def held_ns(self, frame: bytes) -> int:
        """Return how long a frame that has passed check() may hold up the board's receiver, in ns."""
        raise NotImplementedError


class SteeringFrames:
    """Makes and checks the frames that turn the servo of a steered base. Steering counts as motion: the steering frame
    follows the wheels' frame in the same write, and both are accepted or refused together. A stop leaves the angle as
    it is."""

    __slots__ = ()

    def frame(self, angle_rad: float) -> bytes:
        """Return the frame that steers to this angle, positive to the left. Raises FrameError."""
        raise NotImplementedError

    def check(self, frame: bytes) -> str:
        """Return the reason to refuse these bytes as a steering frame, or "" to accept them. Never raises."""
        raise NotImplementedError


class Board:
    """Everything that failstop must know to talk to one board: constants and pure functions. If you describe your own
    board, failstop makes a Board from the description."""

    __slots__ = ()

    name: str
    """The name of the board for people, for example "an Arduino with ros_arduino_bridge"."""
    port: Port
    """How the board's serial port is set up, and how long the board hears nothing after the port was opened. Also the
    frames that are written first after this time. Motion can't be enabled until these frames were written."""
    idle_ns: int
    """How long the line must be silent between a write and the next frame that is not a stop, in ns. 0 if frames may be
    handed to the kernel while others are on their way. A stop does not wait for this."""
    after_ns: int
    """How long a process must keep the line silent after its stop, in ns, even before its own next stop. If this is 0,
    stops may follow each other without a gap. Otherwise the board may lose a stop, so after motion the wheels count as
    moving until the stop was repeated."""
    repeats_ns: tuple[tuple[int, ...], ...]
    """The times at which a writer repeats its stop, in ns after the writer's first stop. Each writer has its own row
    (PORT_OWNER_ROW, STOPPER_ROW, SUPERVISOR_ROW). The writers can't see each other's bytes, so two stops may touch on
    the line, and some boards lose two stops that touch. For such a board each row has different times, so that the next
    stops of the two writers don't touch. The repeats for such a board go on for 0.4 s, which is longer than an adapter
    stalls, and the writers finish them even if the supervisor dies. When motion ends without a stop, the port owner
    repeats the gate's first frame of zeros at the times of its row."""
    stop: bytes
    """The frame that sets every wheel to zero. motor_speeds() makes exactly these bytes for zeros."""
    burst: bytes
    """The bytes that stop the wheels, in one write. If the board's receiver misses the burst, for example because it
    waits for the rest of a cut frame, it receives one of the repeats."""
    first_stop: bytes
    """The beginning of the burst, up to the end of its first stop frame. When a process notices that another one died,
    it writes this before it does anything else, and then the burst. If this is already the whole burst, the burst is
    not written again right after it."""
    refresh: bytes
    """The stop that is written five times per second while the robot is stopped, because the board may have restarted
    or woken up."""
    pings: tuple[bytes, ...]
    """Questions that move nothing, at most layout.PINGS. The board handles pings and all other frames in the order in
    which they were written. All pings differ, and so do their answers, so an answer shows which of these pings was
    asked. The answer also proves that the board received this ping whole. If the board can't be asked, this is empty,
    the state of the link is `unasked`, and nothing waits for an answer."""
    ping_ns: int
    """The time between two pings may be at most this, in ns. If it is longer, stops of this board can't be proved in
    time. 0 means that there is no limit."""
    echo_ns: int
    """The longest time from the write of a command to the board's report that it obeys this command, in ns. 0 if the
    board makes no such reports. If the board makes such reports, a stop is acknowledged only after a report of zeros.
    An answer to a ping is not enough."""
    silent_ns: int
    """If the board's reports about its wheels or its IMU pause for this long, in ns, this counts as a sign that the
    board has restarted. 0 if the board reports nothing."""
    arming: bytes
    """The frame that sets the board's own watchdog. Each time motion is enabled, this frame is written before the first
    motion, because a restart of the board resets the watchdog. Empty if there is nothing to set."""
    fades_ns: int
    """The time, in ns, after which the board's own watchdog acts if no frame comes. From then on the board reports a
    command of zero, which does not prove a stop. 0 if the board makes no such reports, or has no watchdog."""
    acknowledged_by: str
    """How the board acknowledges a stop: BY_ANSWER or BY_ECHO. Empty if it acknowledges nothing."""
    observed_by: str
    """What proves that the wheels are at rest: BY_IMU or BY_WHEELS."""
    per_rps: float
    """How many of the board's speed units make one wheel turn per second."""
    scale_assumed: bool = False
    """True if `per_rps` may be wrong for this robot's motors and encoders: nobody has confirmed it, and the board's
    reports can't reveal an error. A number that a person has written into the settings counts as confirmed only if
    board.per_rps_confirmed has the same number."""
    reports: WheelReports
    """What the board reports about its wheels, and how to read it."""
    wheels: int
    """How many speeds a frame sets, at most box.MOST_SPEEDS. A wheel's wire id is the place of its speed in the
    argument of motor_speeds(), counted from 0."""
    most_rps: float
    """The highest wheel speed that can be sent to the board, in turns per second. If the limits in the settings allow
    more, the service does not start."""
    step_rps: float
    """Speeds are rounded towards zero to a multiple of this, in turns per second. 0 means that any speed can be
    sent."""
    usb: tuple[str, ...]
    """The board's own USB ports as vendor:product in hexadecimal. The chip of a separate USB adapter is not listed,
    because it says nothing about the board behind the adapter."""
    usb_alone: bool
    """True if the board can only be on its own USB port, so it is never behind an adapter or on serial pins."""
    commanders: tuple[Commander, ...]
    """Other programs, devices or people that can command the wheels of this board."""
    arm: ServoBus | None
    """How to talk to the servos of an arm. None if the board has no servos."""

    def hearing(self) -> Hearing:
        """Return a new decoder for the bytes that the board sends."""
        raise NotImplementedError

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """Return the frame that sets all wheels to `rps`, in turns per second by wire id. Raises FrameError if the
        number of speeds is wrong, or if a speed is not finite or not within plus or minus `max_rps`."""
        raise NotImplementedError

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Return the reason to refuse these bytes as a motion frame, or "" to accept them. It does not trust
        motor_speeds(), and reads the form, checksum, ids and speeds from the frame again. It catches a changed bit if
        the frame's form reveals the change. Never raises."""
        raise NotImplementedError

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """Return the speeds that a motion frame sets, in rps by wire id, or None for other bytes. Never raises."""
        raise NotImplementedError

    def commanded(self, frame: bytes) -> Sequence[float] | None:
        """Return the speeds that the board will report while it obeys this motion frame or stop. None for other bytes,
        for a board with pings, and for a board that does not report the command that it obeys. Never raises."""
        return None

    def marked(self, frame: bytes, turn: int) -> bytes:
        """Return the frame to write when the same motion is sent for the `turn`th time. Some boards prove a stop by
        reporting their present command. For them, some turns get a slightly slower frame, so that the reports show
        whether frames still arrive. Other boards get the frame unchanged."""
        return frame

    def buzzer(self, freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
        """Return the frame that sounds the board's buzzer. Empty if the board has no buzzer. Raises FrameError."""
        raise NotImplementedError

    def check_aux(self, frame: bytes) -> str:
        """Return the reason to refuse these bytes as an extra frame, for example for the buzzer, or "" to accept them.
        A frame that moves a wheel or a servo is always refused."""
        raise NotImplementedError

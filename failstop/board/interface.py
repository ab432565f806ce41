"""Interface: everything that failstop needs from a motor board. Each process gets one Board at its start.

described.py makes a Board from a description (wire.py). A board with a gamepad or keys is a class of its own in its
folder. An arm is one optional part of a board (ServoBus).
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
    """A report: its kind, and its value."""

PORT_OWNER_ROW, STOPPER_ROW, SUPERVISOR_ROW = range(3)
"""The writers of stops, as the rows of `repeats_ns`. A program that writes without a service has the last row."""
HEARD_IMU, HEARD_BATTERY, HEARD_PAD, HEARD_KEY, HEARD_SERVO, HEARD_PONG, HEARD_WHEELS, HEARD_OBEYED, HEARD_HEALTH = (
    range(9)
)
HEARD_ODD, HEARD_RESTARTED, HEARD_FIRMWARE = 9, 10, 11
"""The kinds of reports, as a Hearing returns them."""
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
"""The buttons of a gamepad, one bit each."""
BY_ANSWER, BY_ECHO = "answer", "echo"
"""What proves that the board has got a stop: the answer to a later ping, or the board's report of the command that it
obeys."""
BY_IMU, BY_WHEELS = "IMU", "wheels"
"""What proves that the wheels are at rest: the IMU, or the board's reports of their speeds or positions."""


class WheelReports(Data):
    """How to read one board's reports about the wheels (HEARD_WHEELS), in this robot's units."""

    every_ns: int
    """The longest time between two reports of a healthy board in a running service, ns; 0: the board reports
    nothing."""
    speed_per_rps: float
    """How many units of the reported speeds make one turn per second; 0: the board reports no speeds."""
    position_per_turn: float
    """By how much a position grows in one turn of the wheel; 0: positions only show whether the wheel is at rest."""
    wraps: float
    """Positions are counted modulo this; 0: they are not."""
    holds_speed: bool
    """True if the board holds the commanded speed; False if it sets a voltage."""
    own_scale: bool
    """True if the reports do not depend on the setting board.per_rps."""
    position_step: float = 0.0
    """Positions are whole multiples of this, truncated towards zero; 0: too fine to matter."""


UNKNOWN_EVERY_NS = 1_000_000_000
"""The value of every_ns for a board whose description does not say how often it reports."""
NO_WHEEL_REPORTS = WheelReports(0, 0.0, 0.0, 0.0, holds_speed=False, own_scale=False)


class Hearing:
    """Decodes the board's bytes into reports, which are pairs of a kind and a value.

    HEARD_IMU: acceleration x y z in g, turn rate x y z in degrees per second. HEARD_BATTERY: mV, 0 for no battery.
    HEARD_PAD: the gamepad's buttons as in BUTTONS, hat, lx, ly, rx, ry, and the raw frame. HEARD_KEY: id and event.
    HEARD_SERVO: id, the question, its answer. HEARD_PONG: the indices of the pings that it may answer. HEARD_WHEELS:
    (speeds, positions), each empty if the board does not report it. HEARD_OBEYED: the speeds of the command that it
    follows now. HEARD_HEALTH: for each servo its id, its load (-1 to 1), its temperature in degrees Celsius, and what
    is wrong with it (wire.py). HEARD_ODD: the name of a reported value that is impossible, and the value as text; it
    counts as not reported. HEARD_RESTARTED: the text that the board sends when it starts. HEARD_FIRMWARE: the name of a
    firmware that differs from the usual one, once.
    """

    __slots__ = ()

    def feed(self, chunk: bytes) -> list[Said]:
        """All reports that these bytes complete, in order. Never raises."""
        raise NotImplementedError

    def reset(self) -> None:
        """Forget an incomplete report, for example after the port was reopened."""
        raise NotImplementedError


class ServoBus:
    """The servos of an arm, as failstop talks to them: their ids are 1 to 253, their positions pulses (ArmFacts in
    facts.py). servos.py lists what a servo can be asked. Frames for servos are made only if the settings name
    [joints]."""

    __slots__ = ()

    beside_wheels: bool
    """True if the arm may move while the wheels may turn, because no stop waits for a servo."""
    holds_by_goal: bool
    """True if a servo goes on to its last goal by itself, and a stop does not change that goal; in a stream of moves
    the goal is a few degrees ahead. If the servo lags behind, it is sent to where it was read."""

    def stops(self, servos: Sequence[int]) -> bytes:
        """The frames that stop these servos, written after the burst in the same write; empty if a stop leaves them
        alone."""
        raise NotImplementedError

    def move(self, positions: Sequence[tuple[int, int]], duration_ms: int, longest_ms: int = 0) -> bytes:
        """The frame that sends a few servos to these positions, given as (id, pulses), within `duration_ms`. An encoder
        that must avoid some frames may choose another duration, up to `longest_ms` (0: servos.LONGEST_MOVE_MS). Raises
        FrameError."""
        raise NotImplementedError

    def read(self, servo: int, what: int) -> bytes:
        """The frame that asks a servo one of the questions servos.READS. Raises FrameError."""
        raise NotImplementedError

    def look(self, servos: Sequence[int]) -> bytes:
        """The frame that asks a few servos for their positions at once, even while they move; empty if the board has
        none. Raises FrameError."""
        raise NotImplementedError

    def torque(self, servo: int, on: bool, at: int) -> bytes:
        """The frame that switches a servo's torque on or off. `at`: its position, because a servo that keeps its goal
        first gets its present position as the goal. Raises FrameError."""
        raise NotImplementedError

    def command(self, frame: bytes) -> int:
        """The command in a frame that has passed check(), one of those in servos.py."""
        raise NotImplementedError

    def check(self, frame: bytes, servos: Collection[int], longest_ms: int) -> str:
        """Why these bytes must not be written as a frame for an arm with these servos; "" if they may. No motion of the
        wheels passes. Unless it is a question, a frame that passes holds the board's receiver for no longer than
        servos.HELD_NS."""
        raise NotImplementedError

    def moves(self, frame: bytes) -> list[tuple[int, int, int]]:
        """Where a frame sends servos: (id, pulses, duration of the move in ns; 0: as fast as the servo can) for each.
        Empty for other bytes. Never raises."""
        raise NotImplementedError

    def held_ns(self, frame: bytes) -> int:
        """For how long, at most, a frame that has passed check() blocks the receiver, ns."""
        raise NotImplementedError


class SteeringFrames:
    """The frames that turn the servo of a steered base. Steering is motion: its frame follows the one for the wheels in
    the same write, and is admitted and refused with it. A stop has no such frame, so the angle stays as it is."""

    __slots__ = ()

    def frame(self, angle_rad: float) -> bytes:
        """The frame for this angle, positive to the left. Raises FrameError."""
        raise NotImplementedError

    def check(self, frame: bytes) -> str:
        """Why these bytes must not be written to steer; "" if they may. Never raises on bytes."""
        raise NotImplementedError


class Board:
    """The board's language as failstop uses it: constants and pure functions. A description of your own board becomes
    such an object."""

    __slots__ = ()

    name: str
    """The name of the board for people, for example "an Arduino with ..."."""
    port: Port
    """How its serial port is set up, and how long the board hears nothing after that. Motion can't be enabled until the
    board hears and has got its opening frames."""
    idle_ns: int
    """How long the line must be silent after a write before anything but a stop may be written, ns; 0: not at all. A
    stop never waits for this."""
    after_ns: int
    """How long the line must be silent after a stop, ns, even before the next stop of the same writer; 0: stops may
    follow each other directly. If it is not 0, a stop counts as lost until it was repeated."""
    repeats_ns: tuple[tuple[int, ...], ...]
    """A row for each writer (PORT_OWNER_ROW ...): how long after a stop it is written again. Writers that can't see
    each other's bytes have different times, so that no two touch twice in a row. On a board that loses two stops that
    touch, the repeats go on for 0.4 s, longer than an adapter stalls. Writers outlive the supervisor until then. The
    port owner repeats the gate's first zero frame after motion at the same times."""
    stop: bytes
    """The frame that sets every wheel to zero. It has exactly the bytes that motor_speeds() makes for zeros."""
    burst: bytes
    """The bytes of one write that stop the wheels, whatever state the board's receiver is in, at the latest when they
    are repeated."""
    first_stop: bytes
    """The beginning of the burst, up to its first stop frame. It is written before anything else is done. If it is the
    whole burst, the burst is not written again right after it."""
    refresh: bytes
    """The stop that is written five times per second while the robot is stopped, because a board may restart or wake
    up."""
    pings: tuple[bytes, ...]
    """At most layout.PINGS frames that move nothing and that the board answers, in order with all others. All of them
    differ, so an answer shows which ping it belongs to, and proves that the receiver was in step. It may be empty: the
    link is then `unasked`, and nobody waits for an answer."""
    ping_ns: int
    """The longest time between two pings that the proofs about this board need, ns; 0: any."""
    echo_ns: int
    """When the board reports that it obeys zeros, the command was written at least this long before, ns; 0: the board
    does not report the command that it obeys. A board that reports it acknowledges a stop by such a report, not by an
    answer alone."""
    silent_ns: int
    """The board's reports about its wheels or its IMU never pause for this long, ns, unless it restarts; 0: it reports
    nothing."""
    arming: bytes
    """The frame that sets the board's own watchdog. A restart of the board undoes it, so it is written before the first
    motion after each enable. Empty if there is no such watchdog."""
    fades_ns: int
    """How long after the last frame the board's own watchdog makes it report zeros, ns; such zeros prove no stop. 0: it
    has no watchdog, or reports no command."""
    acknowledged_by: str
    """BY_ANSWER or BY_ECHO; empty if the board acknowledges nothing."""
    observed_by: str
    """BY_IMU or BY_WHEELS."""
    per_rps: float
    """How many of the board's speed units make one wheel turn per second."""
    scale_assumed: bool = False
    """True if nobody knows that `per_rps` is right: it depends on this robot's motors and encoders and the board's
    reports use the same number, or a person has only written it into the settings, and board.per_rps_confirmed is
    another number."""
    reports: WheelReports
    """What the board reports about its wheels, and how to read it."""
    wheels: int
    """How many speeds a frame sets, at most box.MOST_SPEEDS. Their wire ids are counted from 0."""
    most_rps: float
    """The highest wheel speed that can be sent to the board, turns per second. The service does not start if the limits
    allow more."""
    step_rps: float
    """Speeds are sent in multiples of this, rounded towards zero, turns per second; 0: any speed can be sent."""
    usb: tuple[str, ...]
    """Vendor:product, in hexadecimal, of the board's own USB ports. The chip of an adapter says nothing about the board
    behind it."""
    usb_alone: bool
    """True if the board can only be on its own USB port, so not behind an adapter and not on serial pins."""
    commanders: tuple[Commander, ...]
    """What else can command the wheels of this board."""
    arm: ServoBus | None
    """The servos of an arm, if the board has them."""

    def hearing(self) -> Hearing:
        """A new decoder for the board's bytes."""
        raise NotImplementedError

    def motor_speeds(self, rps: Sequence[float], max_rps: float) -> bytes:
        """The frame that sets all wheels, in rps by wire id, each within plus or minus max_rps. Raises FrameError, also
        for a speed that is not finite or a wrong number of speeds."""
        raise NotImplementedError

    def check_motion(self, frame: bytes, max_rps: float) -> str:
        """Why these bytes must not be written as a motion frame; "" if they may. It trusts nobody and reads form,
        checksum, ids and speeds again, so a frame with a changed bit is refused as far as its form can tell. Never
        raises on bytes."""
        raise NotImplementedError

    def speeds(self, frame: bytes) -> Sequence[float] | None:
        """The speeds that a motion frame sets, in rps by wire id; None for other bytes. Never raises."""
        raise NotImplementedError

    def commanded(self, frame: bytes) -> Sequence[float] | None:
        """The speeds that the board will report when it obeys this motion frame or stop; None if it reports none, or
        for other bytes. Never raises."""
        return None

    def marked(self, frame: bytes, turn: int) -> bytes:
        """A motion frame that is sent again for the `turn`th time, made slightly slower depending on the turn, because
        reports of a steady command could not show whether frames still arrive. The same frame if no report proves
        anything."""
        return frame

    def buzzer(self, freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
        """The frame that sounds the board's buzzer; empty if it has none. Raises FrameError."""
        raise NotImplementedError

    def check_aux(self, frame: bytes) -> str:
        """Why these bytes must not be written as any other frame; "" if they may. No motion passes, and no frame for a
        servo."""
        raise NotImplementedError

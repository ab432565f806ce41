"""The lines that a driver may write to ros_arduino_bridge, and the answers that it waits for.

They are read as the firmware reads them (ROSArduinoBridge.ino, joshnewans 210a122): the last letter before the first
space is the command; two arguments follow, each after one space, and a further space changes nothing; a CR runs the
line, whatever it holds by then; numbers are atoi's, of 16 bits. An argument of more than 15 bytes would overwrite its
neighbours in the board's memory, so such a line is refused.

Every line has one answer, in order. diffdrive_arduino takes a missing answer to `e`, or another one in its place, for
the counts 0 0; hbrobotics' node asks again forever when `u r w x c s m` are answered by anything but `OK`. So a line
that is refused is still answered as the board would answer it, without its effect.
"""

from __future__ import annotations

import re

from failstop.board.arduino import codec
from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.wire import Wheels

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

_CR, _SPACE = 13, 32
_ARGUMENT = 15
"""How many bytes of an argument fit into the firmware's memory."""
_MOST = 32767
"""The largest number that the firmware's 16-bit integers hold. A larger one would wrap around to another speed."""
_NUMBER = re.compile(rb"[ \t\n\v\f\r]*([+-]?\d+)")
_FASTEST = codec.LIMIT * codec.PERIODS
"""No wheel makes more counts a second than this."""
_NEAR_ZERO = _FASTEST / 4
"""After a restart a board counts from 0 again, and is asked for its counts soon."""
_WRAPS = 2**32
_OK = b"OK\r\n"
_INVALID = b"Invalid Command\r\n"
_REST = (0.0, 0.0)

PATIENCE_NS = 1_000_000_000
"""diffdrive_arduino's default timeout; hbrobotics' node waits longer."""
_LOST_NS = 100_000_000
"""After this time without an answer the board is asked again; failstop itself asks ten times a second."""
_STEADY_NS = 200_000_000
"""A driver that asks for counts at least this often gets those of its last question."""

_GAINS = "the board keeps its gains"
_PINS = "failstop reads no pins, and sets only those that the setting guard.pins names"
_WITHOUT_EFFECT = {
    ord("r"): (_OK, "", ""),
    ord("u"): (_OK, "PID gains (u)", f"{_GAINS}, so build the ones that you need into its firmware"),
    ord("w"): (_OK, "writing a pin (w)", f"{_PINS}; 5, 6, 9, 10, 12 and 13 drive the motors"),
    ord("x"): (_OK, "PWM on a pin (x)", f"{_PINS}; 5, 6, 9 and 10 drive the motors"),
    ord("c"): (_OK, "setting up a pin (c)", _PINS),
    ord("a"): (b"0\r\n", "reading an analog pin (a)", f"{_PINS}, so the answer is 0"),
    ord("d"): (b"0\r\n", "reading a pin (d)", f"{_PINS}, so the answer is 0"),
    ord("p"): (b"0\r\n", "the sonar (p)", "it would keep the board busy for up to a second, so the answer is 0"),
    ord("s"): (_OK, "moving a servo (s)", "failstop knows no servos on this board"),
    ord("t"): (b"0\r\n", "a servo's angle (t)", "failstop knows no servos on this board, so the answer is 0"),
}
"""Commands that change nothing on the board, each with (answer, what it is, why it has no effect). `r` only sets the
counts that the driver sees to zero, so it is not refused."""


class ArduinoDriver:
    """One driver's lines, and the counts that it sees: they begin at 0, as after the reset of a real opening.

    An `e` is answered at once, and the board is asked for the next counts. The answer has the counts that the board
    reported to the driver's last `e`, so a driver that asks at a steady rate gets counts that are one of its own
    periods old each time. Counts that failstop reads for itself come in between, so they would be of any age: they
    answer only a driver that asks too seldom.
    """

    def __init__(self, pins: Collection[int] = ()) -> None:
        """`pins`: the pins that the driver may set."""
        self._pins = pins
        self._asked_ns = 0
        """When the board was asked for counts because the driver sent an `e`; 0: it has answered since."""
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, 0
        self._command = 0
        self._at = 0
        """Which argument the next bytes belong to; 0: none yet."""
        self._arguments = (bytearray(), bytearray())
        self._too_long = False
        self._reader = codec.answers()
        self._counted: tuple[int, int] | None = None
        """The board's counters, as it reported them last."""
        self._counted_ns = 0
        self._counts = [0, 0]
        """The newest counts."""
        self._kept, self._kept_ns = [0, 0], -_STEADY_NS
        """The counts that the board reported to the driver's last question, and when."""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Handle the driver's lines."""
        rows: list[Row] = []
        for byte in chunk:
            if byte == _CR:
                rows += self._run(now_ns)
                self._command, self._at, self._too_long = 0, 0, False
                self._arguments = (bytearray(), bytearray())
            elif byte == _SPACE:
                self._at = min(self._at + 1, 2)
            elif not self._at:
                self._command = byte
            elif len(self._arguments[self._at - 1]) < _ARGUMENT:
                self._arguments[self._at - 1].append(byte)
            else:
                self._too_long = True
        return rows

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Keep the board's counts. Nothing is passed on, because this board only answers."""
        for sample in self._reader.feed(chunk):
            if isinstance(sample, Wheels):
                left, right = sample.positions
                self._count((int(left), int(right)), now_ns)
                if self._asked_ns:
                    self._kept, self._kept_ns, self._asked_ns = self._counts, now_ns, 0
        return []

    def resume(self, before: ArduinoDriver) -> None:
        """Go on with the counts of this driver, because its odometry would jump if they began again."""
        self._counts = self._kept = list(before._counts)

    def _count(self, counters: tuple[int, int], now_ns: int) -> None:
        before, self._counted = self._counted, counters
        passed_ns, self._counted_ns = now_ns - self._counted_ns, now_ns
        if before is None:
            return
        steps = [_wrapped(now - then) for now, then in zip(counters, before, strict=True)]
        largest = max(map(abs, steps))
        restarted = largest > _NEAR_ZERO and max(map(abs, counters)) <= _NEAR_ZERO
        # The robot has not jumped when the board's counters do.
        if not restarted and largest <= _FASTEST * passed_ns / 1e9 + _NEAR_ZERO:
            self._counts = [_wrapped(count + step) for count, step in zip(self._counts, steps, strict=True)]

    def _run(self, now_ns: int) -> list[Row]:
        if self._command == ord("m"):
            return [*self._motion(), DriverAnswer(_OK)]
        if self._command == ord("e"):
            counts = self._kept if now_ns - self._kept_ns < _STEADY_NS else self._counts
            return [DriverAnswer(b"%d %d\r\n" % tuple(counts)), *self._ask(now_ns)]
        if self._command == ord("b"):
            return [DriverAnswer(b"57600\r\n")]
        if self._command == ord("o"):
            return [
                DriverRefusal("raw PWM (o)", "its speed can't be limited, so the wheels were stopped: use m"),
                DriverMotion(_REST, refused=True),
                DriverAnswer(_OK),
            ]
        if frame := self._pin():
            return [frame, DriverAnswer(_OK)]
        if found := _WITHOUT_EFFECT.get(self._command):
            answer, what, why = found
            if self._command == ord("r"):
                self._counts = self._kept = [0, 0]
            return [*([DriverRefusal(what, why)] if what else []), DriverAnswer(answer)]
        if not self._command:
            return [DriverAnswer(_INVALID)]
        what = f"the command {chr(self._command)!r}" if 32 < self._command < 127 else f"the byte {self._command:#04x}"
        why = "ros_arduino_bridge has no such command, so the wheels were stopped: is it made for this board?"
        return [DriverRefusal(what, why), DriverMotion(_REST, refused=True), DriverAnswer(_INVALID)]

    def _ask(self, now_ns: int) -> list[Row]:
        """The question for the next counts, unless one is waiting for its answer."""
        if self._asked_ns and now_ns - self._asked_ns < _LOST_NS:
            return []
        self._asked_ns = now_ns
        return [DriverFrame(codec.POSITIONS, "counts")]

    def _pin(self) -> DriverFrame | None:
        """The line as failstop writes it, if it sets a pin that the driver may set."""
        command = chr(self._command)
        pin, value = (_atoi(bytes(argument)) for argument in self._arguments)
        line = f"{command} {pin} {value}\r".encode()
        if self._too_long or pin not in self._pins or codec.check_aux(line):
            return None
        return DriverFrame(line, f"{command} {pin}")

    def _motion(self) -> list[Row]:
        speeds = [_atoi(bytes(argument)) for argument in self._arguments]
        if self._too_long or max(map(abs, speeds)) > _MOST:
            why = (
                f"the board takes -{_MOST} to {_MOST}, and would turn more into another speed: the wheels were stopped"
            )
            return [DriverRefusal("a speed that is too large (m)", why), DriverMotion(_REST, refused=True)]
        left, right = speeds
        return [DriverMotion((float(left), float(right)))]


def _atoi(text: bytes) -> int:
    """The number at the beginning of a text; 0 if there is none. Digits after a NUL do not count."""
    found = _NUMBER.match(text.partition(b"\0")[0])
    return int(found[1]) if found else 0


def _wrapped(count: int) -> int:
    """The value as the board's counters of 32 bits would hold it."""
    return (count + _WRAPS // 2) % _WRAPS - _WRAPS // 2


def language(settings: Mapping[str, float | str]) -> ArduinoDriver:
    """Begin a driver's conversation. Raises ValueError for the setting guard.pins."""
    words = str(settings.get("guard.pins", "")).split()
    pins = [int(word) if word.isdigit() else -1 for word in words]
    if wrong := [word for word, pin in zip(words, pins, strict=True) if pin not in codec.PINS]:
        allowed = ", ".join(map(str, codec.PINS))
        raise ValueError(f"guard.pins: {wrong[0]}, must be among {allowed}: the others may drive a motor")
    return ArduinoDriver(pins)

"""The lines that a driver may write to ros_arduino_bridge, and the answers that the driver gets.

The lines are read as the firmware reads them (ROSArduinoBridge.ino, joshnewans 210a122). The command is the last byte
before the first space. The first space begins the first argument, and the second space begins the second argument. All
later spaces are ignored. When a CR ends the line, the board executes it, even if an argument is missing. Numbers are
read as atoi() reads them, into 16 bits. A speed or a pin is refused if an argument has more than 15 bytes, because on
the board this argument would overwrite the memory next to it.

Every line gets one answer, in order. A refused line also gets an answer in the board's form. Without the right answer
to `e`, diffdrive_arduino reads the counts as 0 0. hbrobotics' node repeats u, r, w, x, c, s and m until it gets the
answer `OK`, however long this takes.
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
"""The largest number that the firmware's 16-bit integers hold. A larger number would wrap around to another speed."""
_NUMBER = re.compile(rb"[ \t\n\v\f\r]*([+-]?\d+)")
_FASTEST = codec.LIMIT * codec.PERIODS
"""The highest speed of a wheel, in counts per second."""
_NEAR_ZERO = _FASTEST / 4
"""If a counter jumps by more than this, and no counter is further from 0 than this, the board has restarted. A
restarted board counts from 0 again, and failstop asks so soon that the counts are still small."""
_WRAPS = 2**32
_OK = b"OK\r\n"
_INVALID = b"Invalid Command\r\n"
_REST = (0.0, 0.0)

PATIENCE_NS = 1_000_000_000
"""How long a driver waits for an answer, in ns. This is the default timeout of diffdrive_arduino, and hbrobotics' node
waits longer."""
_LOST_NS = 100_000_000
"""How long, in ns, the board may take to answer a question for the encoders' counts. failstop asks it when the driving
program sends `e`. Until the answer or the end of this time, another `e` causes no new question.
After that, the question counts as lost."""
_STEADY_NS = 200_000_000
"""An `e` is answered with the counts that the board reported after the driver's previous `e`. If these counts are older
than this many ns, the `e` is answered with the newest counts instead."""

_GAINS = "the board keeps its gains"
_PINS = "failstop reads no pins, and sets only those that the setting guard.pins names"
_WITHOUT_EFFECT = {
    ord("u"): (_OK, "PID gains (u)", f"{_GAINS}, so build the ones that you need into its firmware"),
    ord("w"): (_OK, "writing a pin (w)", f"{_PINS}; 2 to 10, 12 and 13 may drive the motors"),
    ord("x"): (_OK, "PWM on a pin (x)", f"{_PINS}; 2 to 10, 12 and 13 may drive the motors"),
    ord("c"): (_OK, "setting up a pin (c)", _PINS),
    ord("a"): (b"0\r\n", "reading an analog pin (a)", f"{_PINS}, so the answer is 0"),
    ord("d"): (b"0\r\n", "reading a pin (d)", f"{_PINS}, so the answer is 0"),
    ord("p"): (b"0\r\n", "the sonar (p)", "it would keep the board busy for up to a second, so the answer is 0"),
    ord("s"): (_OK, "moving a servo (s)", "failstop knows no servos on this board"),
    ord("t"): (b"0\r\n", "a servo's angle (t)", "failstop knows no servos on this board, so the answer is 0"),
}
"""Commands that are answered but not passed on to the board: (answer, name, reason) for each. The name and the reason
are for the refusal that people see."""


class ArduinoDriver:
    """Reads the lines that one driver program writes to the guard port, and answers them as the board would. The counts
    begin at 0, because a driver expects that opening the port resets the board.

    When the driver sends `e`, failstop answers at once with the counts that the board reported after the driver's
    previous `e`, and asks the board for new counts. So the counts of a driver that asks at a steady rate always have
    the same age. failstop also asks for counts for its own use, at other times. A driver gets these only if it asks
    less often than every 200 ms (_STEADY_NS), because their age varies.
    """

    def __init__(self, pins: Collection[int] = (), baud: int = codec.USUAL_BAUD) -> None:
        """`pins` are the pins that the driver may set. `baud` is the baud rate of the board's firmware."""
        self._pins, self._baud = pins, baud
        self._asked_ns = 0
        """The time when failstop asked the board for counts because the driver sent an `e`, in ns. 0 if no such
        question waits for its answer."""
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, 0
        self._command = 0
        self._at = 0
        """Which argument the next bytes belong to, 1 or 2. 0 before the first space."""
        self._arguments = (bytearray(), bytearray())
        self._too_long = False
        self._reader = codec.answers()
        self._counted: tuple[int, int] | None = None
        """The board's counters in its newest report."""
        self._counted_ns = 0
        self._counts = [0, 0]
        """The newest counts since the driver opened the port or last sent `r`."""
        self._kept, self._kept_ns = [0, 0], -_STEADY_NS
        """The driver's counts after the board's newest answer to a question that an `e` caused, and the time of this
        answer."""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
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
        """Store the counts that the board reports. Always returns an empty list: the board sends only answers, and
        failstop answers the driver itself."""
        for sample in self._reader.feed(chunk):
            if isinstance(sample, Wheels):
                left, right = sample.positions
                self._count((int(left), int(right)), now_ns)
                if self._asked_ns:
                    self._kept, self._kept_ns, self._asked_ns = self._counts, now_ns, 0
        return []

    def resume(self, before: ArduinoDriver) -> None:
        """Continue the conversation `before` with the same driver. If the counts began at zero again, the driver's
        odometry would jump."""
        self._counts = self._kept = list(before._counts)
        self._command, self._at, self._too_long = before._command, before._at, before._too_long
        first, second = before._arguments
        self._arguments = bytearray(first), bytearray(second)

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
        if self._command == ord("r"):
            # Only failstop's counts for this driver become zero. The board would also stop, because its resetPID() sets
            # the goals of both speed controllers to zero (ROSArduinoBridge.ino).
            self._counts = self._kept = [0, 0]
            return [DriverMotion(_REST), DriverAnswer(_OK)]
        if self._command == ord("b"):
            return [DriverAnswer(b"%d\r\n" % self._baud)]
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
            return [DriverRefusal(what, why), DriverAnswer(answer)]
        if not self._command:
            return [DriverAnswer(_INVALID)]
        what = f"the command {chr(self._command)!r}" if 32 < self._command < 127 else f"the byte {self._command:#04x}"
        why = "ros_arduino_bridge has no such command, so the wheels were stopped: is it made for this board?"
        return [DriverRefusal(what, why), DriverMotion(_REST, refused=True), DriverAnswer(_INVALID)]

    def _ask(self, now_ns: int) -> list[Row]:
        """Return the question for the board's counts, or an empty list while an earlier question waits for its
        answer."""
        if self._asked_ns and now_ns - self._asked_ns < _LOST_NS:
            return []
        self._asked_ns = now_ns
        return [DriverFrame(codec.POSITIONS, "counts")]

    def _pin(self) -> DriverFrame | None:
        """Return the driver's line as failstop writes it, if it sets a pin that the driver may set. None for any other
        line."""
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
    """Return the number at the beginning of a text, as the firmware's atoi reads it. 0 if the text begins with no
    number. Digits after a NUL byte do not count."""
    found = _NUMBER.match(text.partition(b"\0")[0])
    return int(found[1]) if found else 0


def _wrapped(count: int) -> int:
    """Return the count wrapped around to a signed 32-bit number, as the board's counters wrap."""
    return (count + _WRAPS // 2) % _WRAPS - _WRAPS // 2


def language(settings: Mapping[str, float | str]) -> ArduinoDriver:
    """Make an ArduinoDriver for a program that has opened the guard port. Raises ValueError if the setting guard.pins
    names a pin that is not in codec.PINS."""
    words = str(settings.get("guard.pins", "")).split()
    pins = [int(word) if word.isdigit() else -1 for word in words]
    if wrong := [word for word, pin in zip(words, pins, strict=True) if pin not in codec.PINS]:
        allowed = ", ".join(map(str, codec.PINS))
        raise ValueError(f"guard.pins: {wrong[0]}, must be among {allowed}: the others may drive a motor")
    return ArduinoDriver(pins, int(settings.get("board.baud", 0)) or codec.USUAL_BAUD)

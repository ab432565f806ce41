"""The receiver of Waveshare's ugv_base_ros (commit c967326), as a state machine.

- The main loop takes all bytes that have come. A line of any length is kept until its line feed, then read by
  ArduinoJson; what is no JSON is ignored, and so is whatever stands behind the first value.
- T is the command; without one it is 0, the emergency stop: zero speed, and an arm's torque off.
- T:1 with L and R as numbers sets both speeds. Beyond 2 the old ones stay. T:11 sets the PWM, T:13 the speeds from X
  and Z.
- The watchdog sets the speeds to zero once, more than its time after the last T:1 or T:11. T:13 does not feed it.
- T:138 makes the speeds a share of what is commanded. A speed is compared with the one commanded last before the share
  is taken, so that some are not passed on; zero always is.

Not modelled: the ESP32's receive buffer, and commands that block its main loop (T:111, moves of an arm).
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from math import floor

from failstop.board.ugv import codec
from failstop.board.wire import TimedStop, Write
from failstop_lab.boards import arduino_json
from failstop_lab.boards.line import ReceiverModel, Rolling

LOOP_NS = 1_000_000
"""How often its main loop comes round; its real time is not known."""
HEARTBEAT_MS = 3000
FLOW_NS = 50_000_000
TRACK_M = 0.172
COUNT_M = 0.000381
"""How far a wheel goes in one count of its encoder, of the firmware's default main type. L and R of a report are the
counts of the last loop alone."""
FASTEST = 2.0
_MS = 1_000_000


class Ugv(Rolling):
    """`loop_ns`: how often it looks for bytes."""

    def __init__(self, loop_ns: int = LOOP_NS, *, turns: bool = False) -> None:
        self.line = bytearray()
        self.speeds = [0.0, 0.0]
        """Goals of the speed controllers."""
        self.controlled = True
        """Whether they are on; a PWM command switches them off."""
        self.pwm = (0.0, 0.0)
        self.torque_off = 0
        """How often an arm lost its torque."""
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.said: list[tuple[int, bytes]] = []
        self.turns = turns
        """Whether its wheels turn as they are told, and it reports every 50 ms."""
        self.gain = 1.0
        """How many m/s a unit of a command is."""
        self._odometers = [0.0, 0.0]
        self._report_ns = FLOW_NS
        self._compared = [0.0, 0.0]
        self._rates = [1.0, 1.0]
        self._heartbeat_ms = HEARTBEAT_MS
        self._fed_ns = 0
        self._fired = False
        self._came: list[int] = []
        self._loop_ns = self._period_ns = loop_ns
        self._now_ns = 0

    @property
    def wheels(self) -> tuple[float, ...]:
        """Speeds, or a PWM."""
        return tuple(self.speeds) if self.controlled else self.pwm

    def byte(self, at_ns: int, value: int) -> None:
        """A byte waits for the main loop."""
        self.until(at_ns - 1)
        self._came.append(value)

    def until(self, at_ns: int) -> None:
        """The main loop until then."""
        if not self._came and self._fired:
            # Nothing changes in the loops between.
            self._loop_ns = max(self._loop_ns, at_ns - (at_ns - self._loop_ns) % self._period_ns)
        while self._loop_ns <= at_ns:
            self._now_ns = self._loop_ns
            self._loop_ns += self._period_ns
            came, self._came = bytes(self._came), []
            self.take(came)
            self.beat()
        if self.turns and at_ns >= self._report_ns:
            self._report(at_ns)

    def _report(self, at_ns: int) -> None:
        passed_s = (at_ns - self._report_ns + FLOW_NS) / 1e9
        self._report_ns = at_ns + FLOW_NS
        wheels = tuple(speed * self.gain for speed in self.reported)
        self._odometers = [way + 100 * speed * passed_s for way, speed in zip(self._odometers, wheels, strict=True)]
        said = b'{"T":1001,"L":%g,"R":%g,"ax":0,"ay":0,"az":8192,"gx":0,"gy":0,"gz":0,"odl":%d,"odr":%d,"v":1180}\r\n'
        loop_s = self._period_ns / 1e9
        ways_m = [way / 100 for way in self._odometers]
        last = [
            (floor(way / COUNT_M) - floor((way - speed * loop_s) / COUNT_M)) * COUNT_M / loop_s
            for way, speed in zip(ways_m, wheels, strict=True)
        ]
        self.said.append((at_ns, said % (*last, *self._odometers)))

    def take(self, came: bytes) -> None:
        """Bytes, in one run of the main loop."""
        for value in came:
            self.line.append(value)
            if value == 10:
                line, self.line = bytes(self.line), bytearray()
                try:
                    self._run(arduino_json.loads(line))
                except arduino_json.NotJson:
                    continue

    def beat(self) -> None:
        """The watchdog. The firmware compares unsigned: a negative time never ends."""
        late = (self._now_ns - self._fed_ns) // _MS > self._heartbeat_ms % 2**32
        if late and not self._fired:
            self._fired = True
            self._aim(0.0, 0.0)

    def _run(self, command: object) -> None:
        fields = command if isinstance(command, dict) else {}
        kind = _int(fields.get(b"T"))
        left, right = fields.get(b"L"), fields.get(b"R")
        if kind == 0:
            self.torque_off += 1
            self._aim(0.0, 0.0)
            self._note()
        elif kind == 1:
            if _is_number(left) and _is_number(right):
                self._feed()
                self._aim(_float(left), _float(right))
                self._note()
        elif kind == 11:
            self._feed()
            self.controlled, self.pwm = False, (_float(left), _float(right))
            self._note()
        elif kind == 13:
            forward, turn = _float(fields.get(b"X")), _float(fields.get(b"Z")) * TRACK_M / 2.0
            self._aim(forward - turn, forward + turn)
            self._note()
        elif kind == 136:
            self._heartbeat_ms = _int(fields.get(b"cmd"))
        elif kind == 138:
            self._rates = [min(1.0, abs(_float(left))), min(1.0, abs(_float(right)))]
        elif kind == 139:
            self.said.append((self._now_ns, b'{"T":139,"L":%g,"R":%g}\r\n' % tuple(self._rates)))
        elif kind == 126:
            self.said.append((self._now_ns, b'{"T":1002,"r":0,"p":0,"y":0,"q0":1,"q1":0,"q2":0,"q3":0}\r\n'))

    def _feed(self) -> None:
        self._fed_ns, self._fired = self._now_ns, False

    def _note(self) -> None:
        self.commands.append((self._now_ns, self.wheels))

    def _aim(self, left: float, right: float) -> None:
        self.controlled = True
        if abs(left) > FASTEST or abs(right) > FASTEST:
            return
        for wheel, speed in enumerate((left, right)):
            aim = speed * self._rates[wheel]
            if aim != self._compared[wheel]:
                self.speeds[wheel] = aim
                self._compared[wheel] = speed


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _float(value: object) -> float:
    """As ArduinoJson converts: a text by the number in it, anything else is 0."""
    if isinstance(value, bytes):
        try:
            return float(arduino_json.number_text(value))
        except arduino_json.NotJson:
            return 0.0
    return float(value) if isinstance(value, (int, float)) else 0.0


def _int(value: object) -> int:
    """Towards zero; 0 for what does not fit into 32 bits."""
    number = _float(value)
    return int(number) if -(2**31) <= number < 2**31 else 0


def _any_state(rng: random.Random) -> Ugv:
    return Ugv(rng.randrange(_MS // 2, 3 * _MS))


def _every_state() -> Iterator[Ugv]:
    yield from (Ugv(loop_ns) for loop_ns in (_MS // 2, _MS, 3 * _MS))


MODEL = ReceiverModel(
    live=lambda: Ugv(turns=True),
    any_state=_any_state,
    every_state=_every_state,
    # Some are JSON by themselves, or become it by the line feed of the stop.
    before=(b"{}", b"null", b"0" * 300, b"x" * 300, b"\0" * 4, b'"L":0.2,"R":0.2}', b'{"T":13,"X":0.2,"Z":0.1}', b"\r"),
    not_enough=TimedStop((Write(0, codec.STOP[1:]),), 0, ((0,),)),
    fuses=False,
    stalls=True,
    boot=b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0xf (BROWNOUT_RST),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n",
)

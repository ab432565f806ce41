"""The receiver of hoverboard-firmware-hack-FOC (commit a0751d5), as a state machine.

- Bytes go into a ring of 64 by DMA. Nothing looks at them as they come.
- The interrupt handler looks when the line falls idle, one byte's time after the last byte. It asks whether the
  interrupt for an idle line is enabled, not whether it came, so it also looks at the end of each feedback frame.
- A look takes what came since the last look, modulo 64: exactly eight bytes with the right start and xor are the
  command; anything else is dropped. No state but the position is left.
- The main loop, 5 ms and its own body, copies the command to the motors. At the 161st loop without a frame the command
  is zero and the motors coast. The next frame drives at once. Every second loop sends feedback.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from struct import Struct

from failstop.board.hoverboard import codec, feedback
from failstop.board.wire import TimedStop, Write
from failstop_lab.boards.line import ReceiverModel, Rolling

BUFFER = 64
FRAME_LENGTH = 8
CENTIVOLTS = 3650
TIMEOUT_LOOPS = 160
BYTE_NS = 10 * 1_000_000_000 // 115_200
LOOP_NS = 5_062_500
"""81 ticks of the 16 kHz timer; the loop's own body comes on top."""
_COMMAND = Struct("<HhhH")
_NEVER = 1 << 62
FOUR_STEPS = 4 * 10_667.0
"""Ticks in which a wheel of 1 rpm makes four steps (BLDC_controller_data.c: cf_speedCoef)."""
MOST_TICKS = 2000
"""A step that takes longer is none, and the wheel counts as standing (z_maxCntRst)."""


class Hoverboard(Rolling):
    """`first_loop_ns`: when the main loop runs first, which sends feedback; `at`: the position in the ring."""

    def __init__(
        self, first_loop_ns: int = _NEVER, at: int = 0, loop_ns: int = LOOP_NS, *, turns: bool = False
    ) -> None:
        self.ring = bytearray(BUFFER)
        self.at = at
        self.looked_at = at
        self.steer = self.speed = 0
        """The command accepted last."""
        self.loops_without = TIMEOUT_LOOPS
        self.obeyed = (0, 0)
        """Steer and speed that the motors follow, by the last main loop."""
        self.coasts = False
        """Its own watchdog has acted, by the last main loop: the motors get no current."""
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.said: list[tuple[int, bytes]] = []
        self.turns = turns
        """Whether its wheels turn as they are told, in rpm, and its feedback says so."""
        self.counters: tuple[int, ...] = ()
        """Its feedback has these two as well, as the fork's: 22 bytes."""
        self.gain = 1.0
        """How many rpm a unit of a command is."""
        self._timed_out = False
        self._now_ns = 0
        self._idle_ns = _NEVER
        self._sent_ns = _NEVER
        self._loop_ns = first_loop_ns
        self._period_ns = loop_ns
        self._loops = 0

    @property
    def wheels(self) -> tuple[float, ...]:
        """Speeds that the motors follow."""
        return codec.wheels(*self.obeyed)

    def byte(self, at_ns: int, value: int) -> None:
        """A byte that began when the line had been idle for a byte's time comes after the look for it."""
        self.until(at_ns - BYTE_NS)
        # A line that is busy again is not idle any more; its feedback may still end while the byte arrives.
        self._idle_ns = _NEVER
        self.until(at_ns - 1)
        self.received(value)
        self._idle_ns = at_ns + BYTE_NS

    def until(self, at_ns: int) -> None:
        """All that happens until then, in order."""
        while (next_ns := min(self._idle_ns, self._sent_ns, self._loop_ns)) <= at_ns:
            self._now_ns = next_ns
            if next_ns == self._idle_ns:
                self._idle_ns = _NEVER
                self.look()
            elif next_ns == self._sent_ns:
                self._sent_ns = _NEVER
                self.look()
            else:
                self._loop_ns += self._period_ns
                self._main_loop()
        self._now_ns = at_ns

    def _main_loop(self) -> None:
        self.loop()
        if self._loops % 2 == 0:
            reported = self.reported
            turned = (self.gain * reported[0], -self.gain * reported[1])
            left, right = map(self._rpm, turned) if self.turns else (0, 0)
            volts = CENTIVOLTS if self.turns else 0
            frame = feedback.seal(
                *self.obeyed, right_rpm=right, left_rpm=left, centivolts=volts, counters=self.counters
            )
            self.said.append((self._now_ns, frame))
            self._sent_ns = self._now_ns + len(frame) * BYTE_NS
        self._loops += 1

    def _rpm(self, speed: float) -> int:
        """As the firmware measures it: from how many ticks of 16 kHz the last four of 90 steps of a turn took, which
        alternates around the true time; cut to sixteenths of an rpm, and those rounded down to whole ones."""
        if not speed or (ticks := FOUR_STEPS / abs(speed)) > 4 * MOST_TICKS:
            return 0
        whole = int(ticks * (self._loops + 1)) - int(ticks * self._loops)
        sixteenths = int(16 * FOUR_STEPS) // whole
        return (sixteenths if speed > 0 else -sixteenths) >> 4

    def received(self, value: int) -> None:
        """A byte, into the ring."""
        self.ring[self.at] = value
        self.at = (self.at + 1) % BUFFER

    def look(self) -> None:
        """The interrupt handler's look at what came since the last one."""
        came = (self.at - self.looked_at) % BUFFER
        begin, self.looked_at = self.looked_at, self.at
        if came != FRAME_LENGTH:
            return
        frame = bytes(self.ring[(begin + index) % BUFFER] for index in range(FRAME_LENGTH))
        start, steer, speed, check = _COMMAND.unpack(frame)
        if start == codec.START and check == start ^ (steer & 0xFFFF) ^ (speed & 0xFFFF):
            self.steer, self.speed = steer, speed
            self.loops_without, self._timed_out = 0, False
            self.commands.append((self._now_ns, codec.wheels(_clamped(steer), _clamped(speed))))

    def loop(self) -> None:
        """One run of the main loop: from the command to the motors, and the watchdog."""
        self.coasts = self._timed_out = self._timed_out or self.loops_without >= TIMEOUT_LOOPS
        self.loops_without = min(self.loops_without + 1, TIMEOUT_LOOPS)
        self.obeyed = (0, 0) if self.coasts else (_clamped(self.steer), _clamped(self.speed))


def _clamped(word: int) -> int:
    """A word, as the input's calibration leaves it."""
    return max(-int(codec.LIMIT), min(word, int(codec.LIMIT)))


def _any_state(rng: random.Random) -> Hoverboard:
    """Any position in the ring, any phase of its feedback, and a main loop of 5 ms and some body."""
    loop_ns = rng.randrange(5_000_000, 5_130_000)
    return Hoverboard(rng.randrange(2 * loop_ns), rng.randrange(BUFFER), loop_ns)


def _every_state() -> Iterator[Hoverboard]:
    """Every position in the ring, each at some phases of its feedback."""
    for at in range(BUFFER):
        for phase in range(0, 2 * LOOP_NS, BYTE_NS):
            yield Hoverboard(phase, at)


_MS = 1_000_000
MODEL = ReceiverModel(
    live=lambda: Hoverboard(LOOP_NS, turns=True),
    any_state=_any_state,
    every_state=_every_state,
    # Any number of bytes may have come since the last look.
    before=tuple(bytes(count) for count in range(1, BUFFER + 2)),
    # Both writers at the times of the RRC board's writers.
    not_enough=TimedStop((Write(0, codec.STOP),), 0, ((0, 20 * _MS, 100 * _MS), (0, 20 * _MS, 100 * _MS))),
    # By the end of its feedback in the middle: cdab0000 of a cut frame and cdab0000 of a stop, for one.
    fuses=True,
    stalls=False,
)

"""Tap: asks and reads the board at an open port, for programs that are not part of the service."""

from __future__ import annotations

import os
import select
import time

from failstop.board.handled import Answers
from failstop.board.interface import HEARD_FIRMWARE, HEARD_HEALTH, HEARD_OBEYED, HEARD_PONG, Board
from failstop.board.port import waiting_bytes
from failstop.board.wire import SERVO_MISSING

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator

    from failstop.board.interface import Value


class Tap:
    """Writes pings to the board, and reads and decodes its bytes, with the time of each read. The descriptor must be
    non-blocking. The caller closes it."""

    def __init__(self, fd: int, board: Board) -> None:
        self.fd = fd
        self._board = board
        self._hearing = board.hearing()
        self._pings = 0
        self._answers = Answers()
        self.reports: set[int] = set()
        """The kinds of reports that came, except HEARD_PONG (answers to pings) and HEARD_FIRMWARE."""
        self.firmware = ""
        """The name of the board's firmware, if the board reports that it is not the usual one."""
        self.missing: tuple[int, ...] = ()
        """The servos that do not answer, although other servos of the same board do."""
        self.size = 0
        """How many bytes were received."""
        self._flow: set[int] = set()
        """The pings whose answers came before this object had asked these pings. Something else has caused the answers,
        so answers to these pings don't prove that the board hears this object."""

    def read(self) -> list[tuple[int, int, Value]]:
        """Return (time of reading in ns, kind, value) for each new report. Raises OSError if the device is gone."""
        found: list[tuple[int, int, Value]] = []
        while data := waiting_bytes(self.fd):
            now_ns = time.monotonic_ns()
            said = self._hearing.feed(data)
            self.size += len(data)
            self.reports |= {kind for kind, _ in said} - {HEARD_PONG, HEARD_FIRMWARE}
            self.firmware = next((value[0] for kind, value in said if kind == HEARD_FIRMWARE), self.firmware)
            for health in [value for kind, value in said if kind == HEARD_HEALTH]:
                self.missing = tuple(servo for servo, _, _, wrong in health if wrong & SERVO_MISSING)
            answered = {index for kind, indices in said if kind == HEARD_PONG for index in indices}
            self._flow |= {index for index in answered if index >= self._pings}
            found += [(now_ns, *each) for each in said]
        if data is None:
            raise OSError("the device has gone")
        return found

    def _heard(self, timeout_s: float) -> Iterator[tuple[int, int, Value]]:
        """Yield (time of reading in ns, kind, value) for everything that is reported within this time. Raises
        OSError."""
        until_s = time.monotonic() + timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            select.select((self.fd,), (), (), left_s)
            yield from self.read()

    def listen(self, timeout_s: float) -> None:
        """Read until the first report comes, or until the time is over. Raises OSError."""
        for _ in self._heard(timeout_s):
            return

    def ping(self) -> tuple[int, int]:
        """Write the next ping to the board. Returns (index of the ping, time of its write in ns). Raises
        BlockingIOError if the port takes no bytes, and otherwise OSError if the device is gone."""
        index = self._pings % len(self._board.pings)
        now_ns = time.monotonic_ns()
        os.write(self.fd, self._board.pings[index])
        self._pings += 1
        self._answers.asked(index, now_ns)
        return index, now_ns

    def lost(self) -> None:
        """Give up all questions asked so far, for example after a reset of the board. Raises OSError."""
        self.read()
        self._answers = Answers()

    def answers_ns(self, indices: Value, came_ns: int) -> int:
        """Return the time when the earliest ping that fits this answer was written, in ns. 0 if no ping fits. Later
        answers are not matched with this ping or with earlier pings (see handled.py)."""
        return self._answers.answered([index for index in indices if index not in self._flow], came_ns)

    def answered_ms(self, timeout_s: float) -> float | None:
        """Ask the board, and return how long it took to answer, in ms. The answer proves that the board has handled
        everything that was written before the question. Answers to earlier questions don't count. Returns None if no
        answer comes in time, if the board has no questions, or if the port takes no bytes. Raises OSError if the device
        is gone."""
        if not self._board.pings:
            return None
        try:
            _, asked_ns = self.ping()
        except BlockingIOError:
            # As long as for an answer, because callers ask again at once.
            for _ in self._heard(timeout_s):
                pass
            return None
        for now_ns, kind, said in self._heard(timeout_s):
            if kind == HEARD_PONG and self.answers_ns(said, now_ns) >= asked_ns:
                return (now_ns - asked_ns) / 1e6
        return None

    def zeros_ms(self, timeout_s: float) -> float | None:
        """Wait until a board without pings reports that its present command is zero, and return how long that took, in
        ms. None if no such report came in time. Reports that come less than the board's `echo_ns` after the call don't
        count, because they may be about an older command. A report of zeros proves little, because a board that hears
        nothing reports zeros too. Raises OSError."""
        begun_ns = time.monotonic_ns()
        for now_ns, kind, said in self._heard(timeout_s):
            if kind == HEARD_OBEYED and not any(said) and now_ns - begun_ns >= self._board.echo_ns:
                return (now_ns - begun_ns) / 1e6
        return None

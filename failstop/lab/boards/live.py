"""Live: another board's receiver behind a port, as a model that a simulated board's process serves.

Its line is as fast as the board's own, its wheels turn as they are told, and its reports say so. What its wheels are
told is kept as the frames of the first board's model are, so that whoever judges judges all boards alike.
"""

from __future__ import annotations

from collections import deque
from struct import Struct

from failstop.board.framing import MOTOR, WHEELS
from failstop.board.kinds import wire_of
from failstop.lab.boards.line import model_of
from failstop.lab.sim.model import NEVER_NS, BoardModel, Frame, Speeds

STEP_NS = 1_000_000
"""How often time passes for it; its own times are exact all the same."""
DIAMETER_M = 0.08
"""Of its wheels, as the settings have it by default."""
_HEAD, _WHEEL = Struct("<BB"), Struct("<Bf")
_SET_MANY = 1


def _command(speeds: Speeds) -> bytes:
    """The data of the first board's frame for these; what has no wheel is zero there."""
    four = (*speeds, *(0.0,) * (WHEELS - len(speeds)))
    return _HEAD.pack(_SET_MANY, WHEELS) + b"".join(_WHEEL.pack(id_, speed) for id_, speed in enumerate(four))


class LiveModel(BoardModel):
    """One of KINDS, or a board of the user's own."""

    def __init__(self, kind: str, start_ns: int, seed: int = 0) -> None:
        super().__init__(start_ns, imu_hz=0.0, seed=seed)
        wire = wire_of(kind)
        self._byte_ns = wire.port.byte_ns
        self._per_rps = wire.motion.per_rps(DIAMETER_M)
        self._board = model_of(kind).live()
        self.wheels = (0.0,) * wire.motion.wheels
        self._start_ns = self._passed_ns = start_ns
        self._coming: deque[tuple[int, int, int]] = deque()
        """When a byte has come through, which, and when it was read."""
        self._read_ns = start_ns
        """When the last byte that has come through was read."""
        self._battery_ns = NEVER_NS
        self._commands = self._said = 0

    def receive(self, chunk: bytes, t_ns: int) -> None:
        """Take in bytes that were read at t_ns."""
        at_ns = max(self._down_free_ns, t_ns)
        self._down_free_ns = at_ns + self._byte_ns * len(chunk)
        if self.garble_down:
            chunk = self._garbled(chunk, self.garble_down)
        for value in chunk:
            at_ns += self._byte_ns
            if self.cut_bytes:
                self.cut_bytes -= 1
            elif not self.deaf:
                self._coming.append((at_ns, value, t_ns))

    @property
    def next_ns(self) -> int:
        """The next step, or the next byte."""
        return min(self._passed_ns + STEP_NS, self._coming[0][0]) if self._coming else self._passed_ns + STEP_NS

    @property
    def settled_ns(self) -> int | None:
        """A step after the last byte: it may be looked at when the line has fallen idle."""
        return self._coming[-1][0] + STEP_NS if self._coming else None

    def advance(self, now_ns: int) -> list[bytes]:
        """Let everything happen that is due by now_ns; return what it says."""
        while self._coming and self._coming[0][0] <= now_ns:
            at_ns, value, read_ns = self._coming.popleft()
            self._pass(at_ns - self._byte_ns)
            self._read_ns = read_ns
            self._board.byte(at_ns - self._start_ns, value)
        # A line on which a byte has begun is not idle.
        self._pass(min(now_ns, self._coming[0][0] - self._byte_ns) if self._coming else now_ns)
        said = self._board.said[self._said :]
        self._said += len(said)
        return [self._garbled(data, self.garble_up) if self.garble_up else data for _, data in said]

    def _pass(self, until_ns: int) -> None:
        """Time until then, in steps."""
        while self._passed_ns < until_ns:
            self._passed_ns = min(self._passed_ns + STEP_NS, until_ns)
            self._board.until(self._passed_ns - self._start_ns)
            self._take()

    def _take(self) -> None:
        board = self._board
        for at_ns, speeds in board.commands[self._commands :]:
            told = self._rps(speeds)
            frame = Frame(self.executed_total, self._read_ns, at_ns + self._start_ns, MOTOR, _command(told), told, ())
            self._executed.append(frame)
            self.executed_total += 1
        self._commands = len(board.commands)
        self.wheels = self._rps(board.wheels)

    def _rps(self, speeds: tuple[float, ...]) -> Speeds:
        """Turns a second of each wheel."""
        return tuple(speed / self._per_rps for speed in speeds)

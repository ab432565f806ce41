"""Live: another board's receiver behind a port, as a model that a simulated board's process serves.

Its line is as fast as the board's own, its wheels turn as they are told, and its reports say so. What its wheels are
told is kept as the frames of the first board's model are, so that whoever judges judges all boards alike.

`board_model` makes the model of any board.
"""

from __future__ import annotations

from collections import deque
from struct import Struct

from failstop.board.kinds import is_described, wire_of
from failstop.board.rrc.framing import MOTOR, WHEELS
from failstop_lab.boards.line import Receiver, ReceiverModel, Rolling, model_of
from failstop_lab.sim.model import NEVER_NS, BoardModel, Frame, Speeds

STEP_NS = 1_000_000
"""How often time passes for it; its own times are exact all the same."""
QUIET_STEP_NS = 5 * STEP_NS
"""How often, once it has answered what it was sent last."""
ANSWERED_NS = 20 * STEP_NS
NO_CHOICE = "a board of kind {} has a fixed number of motors"
DIAMETER_M = 0.08
"""The wheels' diameter, as in the default settings."""
_HEAD, _WHEEL = Struct("<BB"), Struct("<Bf")
_SET_MANY = 1


def _command(speeds: Speeds) -> bytes:
    """The data of the first board's frame for these; what has no wheel is zero there."""
    four = (*speeds, *(0.0,) * (WHEELS - len(speeds)))
    return _HEAD.pack(_SET_MANY, WHEELS) + b"".join(_WHEEL.pack(id_, speed) for id_, speed in enumerate(four))


class LiveModel(BoardModel):
    """One of KINDS, or a board of the user's own."""

    def __init__(self, kind: str, start_ns: int, seed: int = 0, per_rps: float = 0.0, motors: int = 0) -> None:
        """`per_rps`: one turn a second of its wheels in its own unit, whatever the settings say; 0: as such boards
        usually have it. It is a fact of the simulated motors and encoders, so a wrong setting shows in its wheels.
        `motors`: how many it has; 0: as usual. Raises ValueError."""
        super().__init__(start_ns, imu_hz=0.0, seed=seed)
        wire = wire_of(kind, speeds=motors)
        self._motor_count = motors
        self._byte_ns = wire.port.byte_ns
        self._per_rps = per_rps or wire.motion.per_rps(DIAMETER_M)
        reports = wire.reports
        self._counts_per_turn = 0.0
        if reports and reports.position_per_turn and not reports.own_scale:
            self._counts_per_turn = reports.position_per_turn(self._per_rps, DIAMETER_M)
        self._gain = wire.motion.per_rps(DIAMETER_M) / self._per_rps
        self._kind = kind
        self._begin(start_ns)
        self.wheels = (0.0,) * wire.motion.wheels
        self.turned = (0.0,) * wire.motion.wheels
        self._passed_ns = start_ns
        self._coming: deque[tuple[int, int, int, int]] = deque()
        """When a byte has come through, which, when it was read, and in which read."""
        self._reads = 0
        self._read_ns = start_ns
        """When the last byte that has come through was read."""
        self._busy_ns = 0
        """Until then it may still have to answer."""
        self._hears_ns = 0
        """When it has started: what came before is lost."""
        self._battery_ns = NEVER_NS
        self._commands = self._said = 0

    def _begin(self, start_ns: int) -> None:
        """A receiver that starts then."""
        model = model_of(self._kind)
        self.receiver, self._start_ns = self._live(model), start_ns
        if hasattr(self.receiver, "gain"):
            self.receiver.gain = self._gain
        if model.joints:
            self.servos = model.joints(self.receiver, start_ns)

    def _live(self, model: ReceiverModel) -> Receiver:
        if not self._motor_count:
            return model.live()
        if not model.with_motors:
            raise ValueError(NO_CHOICE.format(self._kind))
        return model.with_motors(self._motor_count)

    def receive(self, chunk: bytes, t_ns: int) -> None:
        """Take in bytes that were read at t_ns."""
        at_ns = max(self._down_free_ns, t_ns)
        self._reads += 1
        self._down_free_ns = at_ns + self._byte_ns * len(chunk)
        if self.garble_down:
            chunk = self._garbled(chunk, self.garble_down)
        for value in chunk:
            at_ns += self._byte_ns
            if self.cut_bytes:
                self.cut_bytes -= 1
            elif not self.deaf and at_ns > self._hears_ns:
                self._coming.append((at_ns, value, t_ns, self._reads))
        self._busy_ns = at_ns + ANSWERED_NS

    def restart(self, t_ns: int, deaf_ns: int) -> None:
        """Its processor begins anew: the wheels stand, and for so long what it is sent is lost."""
        self._coming.clear()
        self._hears_ns = self._passed_ns = t_ns + deaf_ns
        self._begin(self._passed_ns)
        self._commands = self._said = 0
        if self.prints:
            self.receiver.said.append((0, model_of(self._kind).boot))
        self.wheels = (0.0,) * len(self.wheels)

    @property
    def next_ns(self) -> int:
        """The next step, or the next byte."""
        step_ns = self._passed_ns + (STEP_NS if self._passed_ns < self._busy_ns else QUIET_STEP_NS)
        return min(step_ns, self._coming[0][0]) if self._coming else step_ns

    @property
    def settled_ns(self) -> int | None:
        """A step after the last byte: it may be looked at when the line has fallen idle."""
        return self._coming[-1][0] + STEP_NS if self._coming else None

    def advance(self, now_ns: int) -> list[bytes]:
        """Let everything happen that is due by now_ns; return what it says."""
        while self._coming and self._coming[0][0] <= now_ns:
            at_ns, value, read_ns, read = self._coming.popleft()
            self._pass(at_ns - self._byte_ns)
            self._read_ns = read_ns
            self.receiver.byte(at_ns - self._start_ns, value)
            if self._coming and self._coming[0][3] == read:
                self._let_answer()
        # A line on which a byte has begun is not idle.
        self._pass(min(now_ns, self._coming[0][0] - self._byte_ns) if self._coming else now_ns)
        said = self.receiver.said[self._said :]
        self._said += len(said)
        if self.silent:
            return []
        return [self._garbled(data, self.garble_up) if self.garble_up else data for _, data in said]

    def _let_answer(self) -> None:
        """Let the bytes behind a question that were read together with it wait for the answer. A worker of the kernel
        with ordinary priority carries the bytes of a pseudo-terminal. On a busy machine it brings writes that were tens
        of milliseconds apart together, and to take that for a collision on the line would be wrong."""
        if not isinstance(self.receiver, Rolling) or not (over_ns := self.receiver.answers_until_ns()):
            return
        late_ns = over_ns + self._start_ns + self._byte_ns - self._coming[0][0]
        if late_ns > 0:
            self._coming = deque((at_ns + late_ns, value, t_ns, read) for at_ns, value, t_ns, read in self._coming)
            self._down_free_ns += late_ns
            self._busy_ns += late_ns

    def _pass(self, until_ns: int) -> None:
        """Time until then, in steps."""
        while self._passed_ns < until_ns:
            begun_ns = self._passed_ns
            self._passed_ns = min(self._passed_ns + STEP_NS, until_ns)
            if any(self.wheels):
                step_s = (self._passed_ns - begun_ns) / 1e9
                self.turned = tuple(was + rps * step_s for was, rps in zip(self.turned, self.wheels, strict=True))
            self.receiver.until(self._passed_ns - self._start_ns)
            self._accept()

    def _accept(self) -> None:
        board = self.receiver
        for at_ns, speeds in board.commands[self._commands :]:
            told = self._rps(speeds)
            frame = Frame(self.executed_total, self._read_ns, at_ns + self._start_ns, MOTOR, _command(told), told, ())
            self._executed.append(frame)
            self.executed_total += 1
        self._commands = len(board.commands)
        self.wheels = self._rps(board.rolls if isinstance(board, Rolling) else board.wheels)

    def roll(self, faster: float, pushed_rps: float) -> None:
        """Its first wheel turns so many times as fast as it is told, and by `pushed_rps` more."""
        if not isinstance(self.receiver, Rolling):
            raise ValueError("the wheels of this board's receiver do what they are told")
        self.receiver.faster, self.receiver.pushed = faster, pushed_rps * self._per_rps

    def lie(self, times: float = 1.0, more_rps: float = 0.0) -> None:
        """Its reports say that every wheel turns so many times as fast as it does, and by `more_rps` more."""
        if isinstance(self.receiver, Rolling):
            self.receiver.lies, self.receiver.claims = times, more_rps * self._per_rps

    @property
    def driven(self) -> Speeds:
        return self._rps(self.receiver.wheels)

    def disconnect_motor(self, on: bool) -> None:
        """Its last motor hears nothing and says nothing, while the others do. Raises ValueError."""
        if not hasattr(self.receiver, "disconnect_motor"):
            raise ValueError("this board's motors have one controller")
        self.receiver.disconnect_motor(on=on)

    def turn_by_hand(self, wheel: int, turns: float) -> None:
        """A person turns a wheel, and its encoder counts. Raises ValueError."""
        turned = getattr(self.receiver, "turn_by_hand", None)
        if not (turned and self._counts_per_turn and 0 <= wheel < len(self.wheels)):
            raise ValueError(f"wheel {wheel}: this board counts no turns of it")
        turned(wheel, turns * self._counts_per_turn)

    def _rps(self, speeds: tuple[float, ...]) -> Speeds:
        """Turns a second of each wheel."""
        return tuple(speed / self._per_rps for speed in speeds)


def board_model(
    kind: str,
    start_ns: int,
    *,
    imu_hz: float = 110.0,
    battery_mv: int = 12_000,
    seed: int = 0,
    first_invalid: int = 12,
    per_rps: float = 0.0,
    motors: int = 0,
) -> BoardModel:
    """The model of any kind of board, as the setting board.kind names it; the options that such a board has not are
    not looked at. Raises ValueError."""
    if is_described(kind):
        return LiveModel(kind, start_ns, seed, per_rps, motors)
    if motors:
        raise ValueError(NO_CHOICE.format(kind))
    return BoardModel(start_ns, imu_hz=imu_hz, battery_mv=battery_mv, seed=seed, first_invalid=first_invalid)

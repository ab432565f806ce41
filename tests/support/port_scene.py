"""The port owner on a stage."""

from __future__ import annotations

from collections.abc import Callable

from failstop.board.rrc import codec
from failstop.messages import box, layout, records
from failstop.policy import causes
from failstop.procs.port_owner import main
from tests.support.stage import MOST_LATE, MS, Stage

MAX_RPS = 2.0
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)
SLOWER = codec.motor_speeds((0.4, 0.4, -0.4, -0.4), MAX_RPS)
TICK = 20 * MS


class Scene(Stage):
    """A port owner at work on its stage."""

    def __init__(
        self,
        *,
        open_port: bool = True,
        named: bool = True,
        before: Callable[[Scene], object] = lambda scene: None,
        **changed: object,
    ) -> None:
        """`before`: called before the port owner starts."""
        super().__init__(layout.PORT_OWNER, open_port=open_port, **changed)
        if named:
            self.gate = self.start(layout.GATE)
        self.news = self.segment(layout.PORT_OWNER).ring_reader("stops")
        self.black_box = self.segment(layout.PORT_OWNER).ring_reader("box")
        self.port_record = self.segment(layout.PORT_OWNER).latest_reader("port")
        self.stays = True
        self.late = 0
        self.asked: list[int] = []
        before(self)
        self.owner = self.load("failstop.procs.port_owner.main").PortOwner(self)

    def turn(self, elapsed_ns: int = 0, *, alive: bool = True) -> bytes:
        """Time passes, the others beat, the port owner wakes up; returns what it wrote."""
        self.clock.now_ns += elapsed_ns
        if alive:
            self.beat(layout.SUPERVISOR, layout.GATE)
        self.stays = self.owner.turn(self.owner.loop.wait(0))
        self.late = self.late + 1 if self.stays and self.next_ns() <= self.clock() else 0
        assert self.late <= MOST_LATE, "a timer was left behind: the loop would spin"
        return self._without_pings(self.wire.read())

    def next_ns(self) -> int:
        return min(self.clock() + main.TICK_NS, self.owner.loop.due_ns())

    def _without_pings(self, wrote: bytes) -> bytes:
        """They have tests of their own; `asked` keeps their indices, in order."""
        found = sorted((at, i) for i, ping in enumerate(self.board.pings) if (at := wrote.find(ping)) >= 0)
        self.asked += [index for _, index in found]
        for _, index in found:
            wrote = wrote.replace(self.board.pings[index], b"")
        return wrote

    def put(self, frame: bytes = MOTION, *, epoch: int = 1, age_ns: int = 0, kind: int = records.MOTION) -> None:
        self.frames.put(records.FRAME.pack(epoch, kind, frame), self.clock() - age_ns)

    def forward(self, frame: bytes = MOTION, *, elapsed_ns: int = 0, **words: int) -> bytes:
        """The bytes that it writes in a turn for a frame of the gate's, put with these words."""
        self.put(frame, **words)
        return self.turn(elapsed_ns)

    def answer(self, elapsed_ns: int = 0, *, alive: bool = True) -> tuple[bytes, list[str]]:
        """The bytes that it writes in a turn, and the reasons of its own stops."""
        return self.turn(elapsed_ns, alive=alive), self.reasons()

    def drive(self) -> None:
        self.turn()
        assert self.forward() == MOTION
        assert self.owner.admission.wheels_move

    def causes(self) -> list[tuple[int, int, str]]:
        """Stops that it has published since the last call: (epoch, when written, reason). All of them latch."""
        found = []
        while entry := self.news.next():
            epoch, _, written_ns, cause = records.STOPPED.unpack(entry[2])
            found.append((epoch, written_ns, str(causes.read(cause))))
        return found

    def reasons(self) -> list[str]:
        return [reason for _, _, reason in self.causes()]

    def word(self, name: str) -> int:
        return int(self.views[layout.PORT_OWNER].word(name).get())

    def kept(self) -> list[tuple[int, int, int]]:
        """Entries of the black box since the last call, without pings: (kind, bytes, how many of them were taken)."""
        found = []
        while entry := self.black_box.next():
            kind, length, taken, head = box.WIRE.unpack(entry[2])
            if head not in self.board.pings:
                found.append((kind, length, taken))
        return found

    def kept_writes(self) -> list[tuple[int, int, bytes]]:
        """All that it has kept of what the board will answer or echo: (number, time, payload)."""
        ring = self.segment(layout.PORT_OWNER).ring_reader("wrote", from_oldest=True)
        return list(iter(ring.next, None))

    def port_state(self) -> int:
        return self._newest_port()[2]

    def port(self) -> tuple[int, str]:
        number, _, _, path = self._newest_port()
        return number, path

    def _newest_port(self) -> tuple[int, int, int, str]:
        entry = self.port_record.read()
        assert entry is not None
        return records.PORT.unpack(entry[2])

"""The stopper on a stage."""

from __future__ import annotations

from failstop.messages import layout
from failstop.procs.stopper import main
from tests.support.stage import MOST_LATE, MS, Stage


class Scene(Stage):
    """A stopper at work on its stage, beside a port owner that the test plays."""

    def __init__(self, *, open_port: bool = True, named: bool = True, changed: dict[str, object] | None = None) -> None:
        super().__init__(layout.STOPPER, open_port=open_port, **changed or {})
        if named:
            self.port_owner = self.start(layout.PORT_OWNER)
        self.stays = True
        self.late = 0
        self.stopper = self.load("failstop.procs.stopper.main").Stopper(self)
        self.turn()

    def turn(self, elapsed_ns: int = 0, *, alive: bool = True) -> bytes:
        """Time passes, the port owner beats, the stopper wakes up; returns what it wrote."""
        self.clock.now_ns += elapsed_ns
        if alive:
            self.beat(layout.PORT_OWNER)
        self.stays = self.stopper.turn(self.stopper.loop.wait(0))
        self.late = self.late + 1 if self.stays and self.next_ns() <= self.clock() else 0
        assert self.late <= MOST_LATE, "a timer was left behind: the loop would spin"
        return self.wire.read()

    def next_ns(self) -> int:
        return min(self.clock() + main.LONGEST_SLEEP_NS, self.stopper.loop.due_ns())

    def written(self, until_ms: int, *, alive: bool = True) -> list[tuple[int, bytes]]:
        """Bytes that it writes in the coming milliseconds, asked each millisecond."""
        return [(ms, wrote) for ms in range(1, until_ms + 1) if (wrote := self.turn(MS, alive=alive))]

    def port_owner_writes(self) -> None:
        self.views[layout.PORT_OWNER].word("written_ns").set(self.clock())

"""The stopper's loop. It waits until the port owner or the supervisor dies, or until the port owner falls silent. Then
it writes the burst on its own descriptor of the port, and repeats it until a new port owner runs.

If the port owner is silent for too long, the stopper fences it: it sends SIGKILL and writes the burst. When the process
is gone, the stopper writes the burst again, because the port owner may have written one last frame after the first
burst. A working supervisor does all this earlier.

While the port owner is alive, all stops go through it, because only the port owner can make sure that no older motion
frame follows a stop. So when the supervisor dies, the stopper gives the port owner a short time to write the stop
first.
"""

from __future__ import annotations

from time import monotonic_ns

from failstop.board.interface import STOPPER_ROW
from failstop.board.stop_port import StopPort
from failstop.messages import layout
from failstop.policy.processes import HANG_NS
from failstop.procs import starved
from failstop.procs.context import Context
from failstop.procs.handover import HeldPort
from failstop.procs.loop import HANGUP, NEVER, Loop
from failstop.procs.peer import Parent, Peer
from failstop.procs.schedule import ZERO_EVERY_NS, Repeats
from failstop.shm.words import Barrier

LONGEST_SLEEP_NS = 100_000_000
"""The longest sleep, in ns. It is less than half of the stopper's deadline (policy/processes.py), the time for which it
may be silent. Anything that it must notice sooner wakes it."""
FIRST_GO_NS = 3_000_000
"""After the supervisor's death, the stopper waits for the port owner's stop for at most this long, in ns. Then it
writes a stop itself."""
LOOK_AGAIN_NS = 200_000
STALLED_NS = 200_000_000
"""If the stopper itself was silent for this long, it does not judge other processes by their silence, because the whole
service may have been frozen."""


class Stopper:
    """The stopper. Call turn() once per wake-up."""

    def __init__(self, context: Context) -> None:
        port_owner = context.segment("port_owner")
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self._repeats = Repeats(self.loop.timer(), context.board.repeats_ns[STOPPER_ROW], NEVER, ZERO_EVERY_NS * 3 // 2)
        self._port = StopPort(context.fd("port"), context.board, context.settings.servos())
        self._port_owner = Peer(layout.PORT_OWNER, context, self.loop, self._port)
        self._port_owner_written = port_owner.word("written_ns")
        self._port_owner_moving = port_owner.word("moving")
        self._barrier = Barrier()
        self._port_owner_bell = context.bell("port_owner_bell")
        self._written_word = context.own.word("written_ns")
        self.loop.listen(context.bell("bell"), context.early.bell)
        self._turned_ns, self._excused_ns = monotonic_ns(), 0
        self._parent = Parent(context, self.loop, 1, self._port, early=False)
        self.held = HeldPort(context, self.loop, self._parent.control, self._port.adopt, HANGUP)
        self._stopped_for = 0
        """The pid of the last port owner whose death or hang the stopper has handled."""
        self._first_go, self._look_again, self._hang = (self.loop.timer() for _ in range(3))

    def turn(self, ready: dict[int, int]) -> bool:
        """Handle one wake-up. Returns False when it is time to exit."""
        now_ns = monotonic_ns()
        if now_ns - self._turned_ns > STALLED_NS:
            self._excused_ns = now_ns
        self._turned_ns = now_ns
        self._answer_deaths(ready, now_ns)
        self._write_due(now_ns)
        self.held.follow(ready, lost=self._port.lost)
        if not self._parent.orphaned_ns:
            self._follow_port_owner(now_ns)
        self.heartbeat.beat(now_ns)
        return not self._parent.leave(now_ns)

    def _answer_deaths(self, ready: dict[int, int], now_ns: int) -> None:
        """Stop at once if the port owner has died. If the supervisor has died, let the port owner stop first."""
        if died := self._port_owner.died(ready):
            self._port_owner_died(died, now_ns)
            self._port_owner.drop()
        if self._parent.died(ready):
            self._parent.drop(now_ns)
            self._hang.set(NEVER)
            self._first_go.set(now_ns + FIRST_GO_NS if self._port_owner.life else now_ns)

    def _port_owner_died(self, pid: int, now_ns: int) -> None:
        self._stopped_for = pid
        if not self._succeeded():
            self._burst(now_ns)

    def _succeeded(self) -> bool:
        """Return True if a new port owner runs. The new port owner stopped the wheels when it started, and motion may
        have been enabled since. So the stopper must not stop for the previous port owner's death any more."""
        named = self._port_owner.named()
        return named != self._stopped_for and self._port_owner.heart.running(named)

    def _burst(self, now_ns: int) -> None:
        """Write the burst, and plan its repeats."""
        self._write()
        self._repeats.restart(now_ns)

    def _write(self) -> None:
        if self._port.burst():
            self._written_word.set(monotonic_ns())

    def _write_due(self, now_ns: int) -> None:
        """Write the burst or its repeat when it is due. After the supervisor's death, the first burst waits for the
        port owner's own stop, but at most for FIRST_GO_NS. If the port owner has not written a stop by the first
        repeat, kill it."""
        self._repeats.wait(self._port.free_ns)
        if self._first_go.ns != NEVER:
            self._look_again.set(now_ns + LOOK_AGAIN_NS)
            if self._port_owner_written.get() >= self._parent.orphaned_ns or self._first_go.due(now_ns):
                self._first_go.set(NEVER)
                self._look_again.set(NEVER)
                self._burst(now_ns)
        elif self._repeats.pop(now_ns):
            if not self._parent.orphaned_ns and self._succeeded():
                self._repeats.end()  # the new port owner repeats its own stop
                return
            if self._port_owner_written.get() < self._parent.orphaned_ns:
                self._fence()
            self._write()

    def _hangs_ns(self) -> int:
        """Return the time from which the port owner counts as hanging, if it does not beat before. NEVER if no port
        owner runs, or if it was killed already."""
        heart, life = self._port_owner.heart, self._port_owner.life
        if life is None or life.pid == self._stopped_for or not heart.running(life.pid):
            return NEVER
        return max(heart.ns.get(), self._excused_ns) + HANG_NS

    def _follow_port_owner(self, now_ns: int) -> None:
        """Watch the port owner whose pid the supervisor publishes. If it is silent for too long, kill it and write a
        burst. If it is starved and nothing moves, give it the same time again instead (_spares)."""
        if died := self._port_owner.follow():
            self._port_owner_died(died, now_ns)
        if now_ns >= self._hangs_ns():
            if self._spares(now_ns):
                self._excused_ns = now_ns
            else:
                self._fence()  # before the burst, because it may wake up between the burst and the kill
                self._burst(now_ns)
        self._hang.set(self._hangs_ns())

    def _spares(self, now_ns: int) -> bool:
        """Return True if the silent port owner need not be killed. It must be starved, at most starved.LONGEST_NS past
        its deadline, and the last write to the wheels must be a stop."""
        heart, life = self._port_owner.heart, self._port_owner.life
        if not life or heart.age_ns(now_ns) >= HANG_NS + starved.LONGEST_NS:
            return False
        # Read the word `moving` after the look at the process. It then includes what the process was about to write.
        is_starved = starved.look(life.pid, heart, HANG_NS, self._port_owner_bell)
        self._barrier()
        return is_starved and not self._port_owner_moving.get()

    def _fence(self) -> None:
        """Kill the port owner with SIGKILL. Its death is then answered like any other death."""
        if life := self._port_owner.life:
            self._stopped_for = life.pid
            life.kill()


def run(context: Context) -> int:
    """Run until the supervisor has died and the stop for its death is written. To end the service, the supervisor kills
    the stopper instead."""
    stopper = Stopper(context)
    context.run(stopper.turn, stopper.loop, LONGEST_SLEEP_NS)
    stopper.held.let_go()  # an exit would wait for a port that does not drain
    return 0

"""Talk: the conversation with one driver, from its first byte to its end. Pure: every time is an argument.

A DriverLanguage decodes the driver's bytes (failstop/board/driver.py). This file decides which motion counts and for
how long, which answers are still useful, and whether a driver stopped the wheels before it ended.

The guard can't see when a driver wrote a motion. It counts the motion's age from the last moment at which no bytes from
the driver were waiting. So an old motion never looks new, even if the guard was held up or the driver writes faster
than the guard reads.
"""

from __future__ import annotations

from math import isfinite

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.board.driver import DriverLanguage

RENEW_NS = 100_000_000
"""While a motion counts, the guard repeats the motion's command at least this often, because the motion may count for
longer than the service lets one command count."""
FRAME_EVERY_NS = 20_000_000
"""The shortest time between two frames that are not motion. More frequent frames would leave too little of the
serial line for motion."""
MOST_FRAMES = 8
"""How many frames that are not motion may wait to be sent, one of each kind. A frame of a further kind is dropped."""
MOST_REFUSALS = 32
"""How many different refusals are reported for one driver."""
LATE_FOR_NS = 3_000_000_000
"""If a driver got a late answer within this time before its end, the report about its end mentions the late answer."""
NOT_WHEELS = "a motion that is not valid"


class Command(Data):
    """A command for the service: the wheels' speeds by wire id, in the board's unit. `t_ns`: the time from which the
    service counts the command's age. `stands_in`: True if the speeds are zero in place of a motion that the driver
    wants. The service then does not take the zeros for a driver that has let go."""

    speeds: tuple[float, ...]
    t_ns: int
    steering_rad: float | None = None
    stands_in: bool = False


class Talk:
    """What one driver has written, and which commands follow from it."""

    def __init__(self, language: DriverLanguage, wheels: int, timeout_ns: int, source_ns: int) -> None:
        """`wheels`: how many speeds a motion has. `timeout_ns`: how long the driver's newest motion counts (the setting
        guard.timeout_s). `source_ns`: how long the service lets one command count."""
        self._language = language
        self._wheels = wheels
        self.timeout_ns, self._source_ns = timeout_ns, source_ns
        self._renew_ns = min(RENEW_NS, source_ns // 3)
        self._speeds: tuple[float, ...] | None = None
        self._steering_rad: float | None = None
        self._lets_go = True
        """True if the driver's own newest motion is zero, or if the driver has written no motion. If failstop refuses a
        motion and replaces it with a stop, that stop is not the driver's own."""
        self.withheld = False
        """True if the driver was driving when the service was restarted, and has neither let go nor paused since. In
        the meantime somebody may have enabled motion, when the new run did not know the driver yet. So zeros stand in
        for the driver's motions."""
        self.refused = ""
        """Why the driver's newest motion was replaced by a stop, for people. Empty if it was not replaced."""
        self._paused_ns = 0
        """If the driver's next motion was written later than this, the driver has paused."""
        self._written_ns = 0
        """The earliest time at which the driver may have written its newest motion."""
        self._late_ns = self._late_at_ns = 0
        """For the driver's newest late answer: how long the driver may have waited for it, and when it was given, both
        in ns."""
        self._sent_ns: int | None = None
        """The `t_ns` of the newest command that was made from the current motion. None if no command was made from it
        yet."""
        self._over = False
        """True if the guard was held up for so long that the service has let the motion expire. The wheels then turn
        only for a new motion of the driver."""
        self._frames: dict[str, DriverFrame] = {}
        """The driver's waiting frames that are not motion, by kind. The oldest kind comes first."""
        self._framed_ns = -FRAME_EVERY_NS
        self._known: set[str] = set()
        self.refusals: list[DriverRefusal] = []
        """New refusals, for people. The guard's loop reports them and empties the list."""

    def resume(self, before: Talk) -> None:
        """Continue the conversation `before` with the same driver, after the service was restarted."""
        self.adopt(before)
        self._lets_go, self.withheld = before._lets_go, before.holds

    @property
    def motion(self) -> tuple[float, ...] | None:
        """The newest motion, or None if the driver has written none."""
        return self._speeds

    @property
    def drives(self) -> bool:
        """True if the newest motion has a speed other than zero, no matter how old it is."""
        return self._speeds is not None and any(self._speeds)

    def silent_ns(self, now_ns: int) -> int:
        """How long ago the driver's newest motion expired, ns. 0 if the motion still counts or is zero."""
        return max(0, now_ns - self._written_ns - self.timeout_ns) if self.drives else 0

    def wrote(self, chunk: bytes, now_ns: int, since_ns: int) -> list[bytes]:
        """Handle bytes that the driver wrote after `since_ns` and not later than `now_ns`. Returns the answers for the
        driver. If the answers are late, returns only the newest one."""
        rows = self._language.wrote(chunk, now_ns)
        answers = [row.data for row in rows if isinstance(row, DriverAnswer)]
        motions = [row for row in rows if isinstance(row, DriverMotion)]
        why = ""
        for row in rows:
            if isinstance(row, DriverRefusal):
                self.refuse(row.what, row.why)
                why = f"{row.what}: {row.why}"
            elif isinstance(row, DriverMotion) and row.renews:
                self.refused = why if row.refused else ""
            elif isinstance(row, DriverFrame) and (row.kind in self._frames or len(self._frames) < MOST_FRAMES):
                self._frames[row.kind] = row
        if renewing := [row for row in motions if row.renews]:
            self._lets_go = self._let_go_by(renewing)
            self.withheld = self.withheld and self.holds and since_ns <= self._paused_ns
            self._paused_ns = now_ns + self.timeout_ns
            self._move(renewing[-1].speeds, since_ns)
        if motions:
            self._steer(motions[-1].steering_rad, now_ns)
        late = now_ns - since_ns > self._language.patience_ns
        if late and answers:
            self._late_ns, self._late_at_ns = now_ns - since_ns, now_ns
        return answers[-1:] if late else answers

    def late(self, now_ns: int) -> tuple[int, int] | None:
        """Return (how long the driver may have waited for its newest late answer, how long this kind of driver waits
        for an answer), in ns. None if no answer was late within the last LATE_FOR_NS."""
        if not self._late_at_ns or now_ns - self._late_at_ns > LATE_FOR_NS:
            return None
        return self._late_ns, self._language.patience_ns

    def adopt(self, before: Talk) -> None:
        """Continue with what the driver has set up on the board in the conversation `before`, and with the beginning of
        a frame that it has written. No motion is taken over, but a driver that must let go first must still do so."""
        self.withheld, self._paused_ns = before.withheld, before._paused_ns
        if type(self._language) is type(before._language) and (resume := getattr(self._language, "resume", None)):
            resume(before._language)

    def asked(self, chunk: bytes, now_ns: int) -> list[bytes] | None:
        """Handle bytes from this driver or from a driver that has gone. Returns the answers. Returns None if the bytes
        contain a motion other than zero. The caller must then drop this conversation, so that none of the bytes
        counts."""
        rows = self._language.wrote(chunk, now_ns)
        if any(isinstance(row, DriverMotion) and any(row.speeds) for row in rows):
            return None
        return [row.data for row in rows if isinstance(row, DriverAnswer)]

    def frame(self, now_ns: int) -> DriverFrame | None:
        """Pop the driver's next frame that is not motion. Returns None if no frame is due now."""
        if not self._frames or now_ns - self._framed_ns < FRAME_EVERY_NS:
            return None
        self._framed_ns = now_ns
        return self._frames.pop(next(iter(self._frames)))

    def _move(self, speeds: Sequence[float], since_ns: int) -> None:
        found = tuple(map(float, speeds))
        if len(found) != self._wheels or not all(map(isfinite, found)):
            self.refuse(NOT_WHEELS, f"{self._wheels} finite speeds were expected, so the wheels were stopped")
            found = (0.0,) * self._wheels
        self._speeds, self._written_ns, self._sent_ns, self._over = found, since_ns, None, False

    def _steer(self, steering_rad: float | None, now_ns: int) -> None:
        """Take the angle of the steered wheels. While the motion counts, the angle is sent at once. Otherwise it takes
        effect with the next motion."""
        changed, self._steering_rad = steering_rad != self._steering_rad, steering_rad
        counts = self._sent_ns is not None and now_ns - self._sent_ns < self._source_ns
        if changed and counts and not self._over:
            self._sent_ns = None

    def refuse(self, what: str, why: str) -> None:
        """Add a refusal to `refusals`, once for each `what` and for at most MOST_REFUSALS of them. `what`: the driver's
        request. `why`: what failstop did instead."""
        if what not in self._known and len(self._known) < MOST_REFUSALS:
            self._known.add(what)
            self.refusals.append(DriverRefusal(what, why))

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Handle bytes from the board. Returns the frames for the driver. The caller must write each frame whole."""
        return self._language.heard(chunk, now_ns)

    def command(self, now_ns: int) -> Command | None:
        """The command to send to the service now. None if the service needs no new command.

        The service lets a command count only for its own timeout, which may be shorter than the driver's. So the guard
        repeats the command while the driver's motion counts. The last command's `t_ns` makes the command expire exactly
        when the motion does. So the wheels stop in time even if the guard hangs."""
        if self._speeds is None or self._over:
            return None
        last_ns, sent_ns = self._last_ns, self._sent_ns
        t_ns = min(now_ns, last_ns)
        if sent_ns is not None:
            early = t_ns < last_ns and t_ns - sent_ns < self._renew_ns
            # If the guard itself was held up, it renews nothing, because the service would take it for a new command.
            self._over = now_ns - sent_ns > self._source_ns
            if t_ns <= sent_ns or early or self._over:
                return None
        self._sent_ns = t_ns
        speeds = (0.0,) * self._wheels if self.withheld else self._speeds
        return Command(speeds, t_ns, self._steering_rad, stands_in=self.holds and not any(speeds))

    @property
    def _last_ns(self) -> int:
        """The `t_ns` of the motion's last command, which expires together with the motion."""
        return self._written_ns + self.timeout_ns - self._source_ns

    def due_ns(self) -> int | None:
        """When command() or frame() will next return something if the driver writes nothing more. None if both will
        return nothing."""
        motion_ns = self._motion_due_ns()
        if not self._frames:
            return motion_ns
        frame_ns = self._framed_ns + FRAME_EVERY_NS
        return frame_ns if motion_ns is None else min(motion_ns, frame_ns)

    def _motion_due_ns(self) -> int | None:
        if self._speeds is None or self._over:
            return None
        if self._sent_ns is None:
            return self._written_ns
        return min(self._sent_ns + self._renew_ns, self._last_ns) if self._sent_ns < self._last_ns else None

    def ended(self, unread: bytes, now_ns: int) -> bool:
        """End the conversation with a driver that has gone. `unread`: bytes from the driver that were not read yet.
        Returns True if the driver's own newest motion is not zero. A motion in `unread` counts for this, but is not
        carried out."""
        motions = [row for row in self._language.wrote(unread, now_ns) if isinstance(row, DriverMotion)]
        return not self._let_go_by(motions)

    @property
    def holds(self) -> bool:
        """True if the driver's own newest motion is not zero, even if failstop has stopped the wheels."""
        return not self._lets_go

    def _let_go_by(self, motions: Sequence[DriverMotion]) -> bool:
        own = [any(row.speeds) for row in motions if row.renews and not row.refused]
        return not own[-1] if own else self._lets_go

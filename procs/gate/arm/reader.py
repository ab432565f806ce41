"""Reader: asks the servos one question at a time, and decides which answers can be trusted. Pure.

The firmware does not match answers with questions. If an answer is late, the firmware returns it as the answer to the
next question. It then answers the question after the next one with the value 0, as if a servo had answered. So the
reader ignores the first answer after an unanswered question. It believes the position of a resting joint only if two
readings in a row agree, and the value 0 only for the torque.
"""

from __future__ import annotations

from failstop.board.servos import LONGEST_MOVE_NS, POSITION, SILENT_NS, SUPPLY, TEMPERATURE, TORQUE
from failstop.policy.joints import MOST_MISSES, Joint

FRAME_JITTER_NS = 3_000_000
"""On a busy machine, the port owner may get one frame late and the next one in time. The two frames then come up to
this much closer together than the gate sent them. The port owner would drop a question that comes too soon, and the
servo would seem not to answer."""
QUIET_NS = LONGEST_MOVE_NS + 4 * FRAME_JITTER_NS
"""The shortest time between the last move and the next question. The port owner drops a question while a servo may
still be moving."""
APART_NS = SILENT_NS + FRAME_JITTER_NS
"""The shortest time between two questions. The port owner drops a question while an earlier one may still block the
receiver."""
WAIT_NS = 40_000_000
"""How long to wait for an answer. An answer normally takes a few milliseconds, through the board, the port owner and
telemetry."""
IDLE_NS = 150_000_000
"""The time between two questions while nobody waits for the answers."""
AGREE = 5
"""How many pulses two readings of a resting servo may differ."""
LOOKS_APART_NS = 16_000_000
"""The time between two questions about moving joints, on a board that has such questions. With six joints, each joint
is read 30 times per second."""
LOOKED = 3
"""How many joints are read by each question about moving joints."""
_OTHERS = (TEMPERATURE, TORQUE, SUPPLY)


class ServoReader:
    """Keeps track of the question that is waiting for its answer, and chooses the next one."""

    def __init__(self, joints: list[Joint], now_ns: int) -> None:
        self._joints = joints
        self._asked: tuple[Joint, int] | None = None
        self._asked_ns = 0
        self._next_ns = now_ns
        self._quiet_ns = now_ns + QUIET_NS
        self._distrust = False
        self._turn = 0
        self._idle = self._looked = 0
        self.look_ns = now_ns
        """The earliest time, in ns, for the next question about the joints that are moving."""

    def look(self, now_ns: int) -> list[Joint]:
        """Return the next few joints to ask for their positions while the arm moves. Empty if it is too early to
        ask."""
        if now_ns < self.look_ns:
            return []
        self.look_ns, at = now_ns + LOOKS_APART_NS, self._looked
        self._looked = at + LOOKED if at + LOOKED < len(self._joints) else 0
        return self._joints[at : at + LOOKED]

    def seen(self, servo: int, value: int, t_ns: int) -> None:
        """Record the position of a joint while the arm moves. One reading is enough, because no command depends on
        it."""
        for joint in self._joints:
            if joint.servo == servo:
                joint.measured, joint.measured_ns, joint.misses = value, t_ns, 0

    def moved(self, now_ns: int) -> None:
        """Record that a servo was moved. ask() then returns no question until the servo has certainly stopped."""
        self._quiet_ns = now_ns + QUIET_NS

    def free_ns(self) -> int:
        """Return the time when the board's receiver is free again after the last question, even if no answer comes."""
        return self._asked_ns + APART_NS if self._asked_ns else 0

    def due_ns(self) -> int:
        return self._asked_ns + WAIT_NS if self._asked else max(self._next_ns, self._quiet_ns)

    def ask(self, wanted: list[Joint], now_ns: int) -> tuple[Joint, int] | None:
        """Return the question to ask now, as (joint, kind of value), or None if it is too early to ask. `wanted`: the
        joints whose positions are needed first."""
        if self._asked and now_ns >= self._asked_ns + WAIT_NS:
            self._missed(self._asked[0])
        if self._asked or now_ns < self._next_ns or now_ns < self._quiet_ns:
            return None
        self._turn += 1
        if wanted:
            joint, what = wanted[self._turn % len(wanted)], POSITION
            if joint.unpaired is None:  # ask this joint again at once, for the second reading
                self._turn -= 1
        else:
            joint, what = self._idly()
        self._asked, self._asked_ns = (joint, what), now_ns
        self._next_ns = now_ns + (APART_NS if wanted else IDLE_NS)
        return self._asked

    def _idly(self) -> tuple[Joint, int]:
        """Return the next question while nobody waits for an answer, as (joint, kind of value). Each joint in turn is
        asked twice for its position, and then for its temperature, torque or supply voltage."""
        step, self._idle = self._idle, self._idle + 1
        joint = self._joints[step // 3 % len(self._joints)]
        return joint, POSITION if step % 3 < 2 else _OTHERS[step // 3 // len(self._joints) % len(_OTHERS)]

    def hurry(self, now_ns: int) -> None:
        """End the long pause (IDLE_NS), because somebody waits for positions now. The next question may be asked as
        soon as the receiver is free."""
        if not self._asked:
            self._next_ns = min(self._next_ns, max(now_ns, self._asked_ns + APART_NS))

    def answer(self, servo: int, what: int, value: int | None, t_ns: int) -> Joint | None:
        """Record an answer from the board. Returns the joint whose position has become known, or None."""
        if self._asked is None or (self._asked[0].servo, self._asked[1]) != (servo, what):
            return None
        joint = self._asked[0]
        if value is None:
            self._missed(joint)
            return None
        self._asked = None
        if self._distrust:
            self._distrust = False
            if value:
                joint.misses = 0  # the value may belong to another question, but it shows that the servo answers
            return None
        if what == TORQUE:
            joint.loaded = value > 0
        elif not value:
            self._missed(joint)
            return None
        joint.misses = joint.misses if what == TORQUE else 0
        if what == TEMPERATURE:
            joint.temperature_c = value
        elif what == SUPPLY:
            joint.supply_mv = value
        elif what == POSITION:
            before, joint.unpaired = joint.unpaired, value
            if before is not None and abs(value - before) <= AGREE:
                joint.measured, joint.measured_ns = round((value + before) / 2), t_ns
                return joint
        return None

    def _missed(self, joint: Joint) -> None:
        self._asked = None
        self._distrust = True
        joint.misses = min(joint.misses + 1, MOST_MISSES)
        joint.unpaired = None
        if joint.silent:
            # The servo may have lost its power, and with it its torque, so the joint may have sagged.
            joint.forget()
            joint.loaded = None

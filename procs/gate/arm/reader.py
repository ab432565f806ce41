"""Reader: asks the servos one question at a time, and says what of the answers may be believed. Pure.

The firmware compares no answer with its question: one that comes late is taken for that of the next question, which
then succeeds with 0. So after a question without an answer the next one counts for nothing, nor does any 0; a position
counts when two in a row agree.
"""

from __future__ import annotations

from failstop.board.servos import LONGEST_MOVE_NS, POSITION, SILENT_NS, SUPPLY, TEMPERATURE, TORQUE
from failstop.policy.joints import MOST_MISSES, Joint

FRAME_JITTER_NS = 3_000_000
"""By how much the port owner may come later to one frame than to the next, on a busy machine: what is too near to the
frame before it is dropped there, and would count as a question without an answer."""
QUIET_NS = LONGEST_MOVE_NS + 4 * FRAME_JITTER_NS
"""After the last move: the port owner lets no question pass before every servo stands."""
APART_NS = SILENT_NS + FRAME_JITTER_NS
"""Between two questions: the port owner lets none pass while an earlier one may still hold the receiver."""
WAIT_NS = 40_000_000
"""An answer takes some milliseconds through board, port owner and telemetry; later than this none comes."""
IDLE_NS = 150_000_000
"""Between two questions that nobody waits for."""
AGREE = 5
"""Pulses by which two readings of a servo that stands may differ."""
LOOKS_APART_NS = 16_000_000
"""Between two looks at joints on their way, where the board takes such questions: each of six has 30 a second."""
LOOKED = 3
"""Joints in a look."""
_OTHERS = (TEMPERATURE, TORQUE, SUPPLY)


class ServoReader:
    """The question that is out, and the next one."""

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
        """When joints on their way may be looked at again."""

    def look(self, now_ns: int) -> list[Joint]:
        """The joints of the next look; empty: none is due."""
        if now_ns < self.look_ns:
            return []
        self.look_ns, at = now_ns + LOOKS_APART_NS, self._looked
        self._looked = at + LOOKED if at + LOOKED < len(self._joints) else 0
        return self._joints[at : at + LOOKED]

    def seen(self, servo: int, value: int, t_ns: int) -> None:
        """A position of a joint on its way: one reading is enough, as nothing is sent by it."""
        for joint in self._joints:
            if joint.servo == servo:
                joint.measured, joint.measured_ns, joint.misses = value, t_ns, 0

    def moved(self, now_ns: int) -> None:
        """A servo was sent somewhere: no question before it stands."""
        self._quiet_ns = now_ns + QUIET_NS

    def free_ns(self) -> int:
        """When the receiver is free of the last question for certain: before that the port owner lets nothing pass."""
        return self._asked_ns + APART_NS if self._asked_ns else 0

    def due_ns(self) -> int:
        return self._asked_ns + WAIT_NS if self._asked else max(self._next_ns, self._quiet_ns)

    def ask(self, wanted: list[Joint], now_ns: int) -> tuple[Joint, int] | None:
        """The question to ask now; None: none is due. `wanted`: whose position somebody waits for."""
        if self._asked and now_ns >= self._asked_ns + WAIT_NS:
            self._missed(self._asked[0])
        if self._asked or now_ns < self._next_ns or now_ns < self._quiet_ns:
            return None
        self._turn += 1
        if wanted:
            joint, what = wanted[self._turn % len(wanted)], POSITION
            if joint.unpaired is None:  # its second reading at once
                self._turn -= 1
        else:
            joint, what = self._idly()
        self._asked, self._asked_ns = (joint, what), now_ns
        self._next_ns = now_ns + (APART_NS if wanted else IDLE_NS)
        return self._asked

    def _idly(self) -> tuple[Joint, int]:
        """Positions twice in a row, and now and then one of the rest."""
        step, self._idle = self._idle, self._idle + 1
        joint = self._joints[step // 3 % len(self._joints)]
        return joint, POSITION if step % 3 < 2 else _OTHERS[step // 3 // len(self._joints) % len(_OTHERS)]

    def hurry(self, now_ns: int) -> None:
        """Somebody waits from now on: an idle pause ends."""
        if not self._asked:
            self._next_ns = min(self._next_ns, max(now_ns, self._asked_ns + APART_NS))

    def answer(self, servo: int, what: int, value: int | None, t_ns: int) -> Joint | None:
        """An answer of the board; returns whose position is known by it, if one is."""
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
                joint.misses = 0  # the value may be another question's, but something answers
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

"""Duties: fleet stops on the robot's side, which of them it obeys, and when it answers what. Pure.

The robot first requests a stop and then remembers its id. If it crashes in between, the worst that can happen is that
the same stop is obeyed twice.
"""

from __future__ import annotations

from failstop.fleet import levels, replay, signed
from failstop.fleet.levels import Order, StopAnswer
from failstop.policy.proofs import LINK_ALIVE, LINK_UNASKED

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State, Stop
    from failstop.fleet.replay import Seen

FOLLOWED_S = 6.0
"""How long a stop is followed, s. All its proofs are known by then."""
AGAIN_EVERY_S = 0.25
"""An id that comes again is answered at most this often, s."""
MOST_DUTIES = 32
UNWRITTEN = "latched but NOT written, so the board did not get it"
FORGOTTEN = "requested, but then its publisher was restarted, so nobody knows whether the robot stopped"


class Duty:
    """One stop that this robot carries out."""

    def __init__(self, order: Order, now_s: float, unix_s: float, before: State | None) -> None:
        """The request is in the stop pipe. `now_s`: now (time.monotonic()); `before`: the service's state before the
        request, None if it could not be read."""
        self.id = order.id
        self.reached: dict[str, float] = {levels.ASKED: 0.0}
        self.why = ""
        self.confirms = levels.ACKNOWLEDGED
        self.told_s = now_s
        self._since_s = now_s
        self._unix_s = unix_s
        self._epoch = before.epoch if before else None
        self._latched = before.cause if before else None

    def look(self, state: State | None, now_s: float) -> bool:
        """Follow this stop. True if a further level was reached."""
        stop = state.last_stop if state else None
        if state is None or stop is None or not self._answers_it(state, stop):
            return False
        self.confirms = confirming(state)
        known = {
            levels.FAILED: stop.written_s is None,
            levels.WRITTEN: stop.written_s is not None and stop.sent and stop.believed,
            levels.ACKNOWLEDGED: stop.written_s is not None and stop.acknowledged_s is not None,
            levels.OBSERVED: stop.written_s is not None and stop.observed_s is not None,
        }
        new = {
            level: round(now_s - self._since_s, 4) for level, so in known.items() if so and level not in self.reached
        }
        self.reached |= new
        self.why = UNWRITTEN if known[levels.FAILED] else ""
        return bool(new)

    def _answers_it(self, state: State, stop: Stop) -> bool:
        """True if the service's last `stop` answers this request: it came after the request, or it was latched before
        and still is. In the second case the service must have heard the request (its epoch grew) and still hear the
        board; it then only keeps the first stop."""
        if self._epoch is None:
            return stop.t >= self._unix_s
        was_latched = self._latched is not None and state.cause == self._latched
        return stop.epoch > self._epoch or (
            was_latched and state.epoch > self._epoch and state.device.link in (LINK_ALIVE, LINK_UNASKED)
        )

    def open(self, now_s: float) -> bool:
        """True while more may become known about this stop."""
        return now_s - self._since_s <= FOLLOWED_S and not set(levels.PROOFS) <= set(self.reached)


def confirming(state: State) -> str:
    """The level at which a stop of this robot counts as confirmed: acknowledged, if its board can answer; else
    observed, if it has an IMU; else written."""
    if state.device.link != LINK_UNASKED:
        return levels.ACKNOWLEDGED
    return levels.OBSERVED if state.imu else levels.WRITTEN


class Duties:
    """Decides about each message on the stop topic, and what this robot answers."""

    def __init__(self, key: bytes, robot: str, seen: Seen) -> None:
        self.forged = 0
        """How many messages were not signed with the fleet's key."""
        self.last_forged = ""
        self._key = key
        self._robot = robot
        self._seen = seen
        self._duties: dict[str, Duty] = {}
        self._followed: list[Duty] = []
        self._new: list[str] = []
        """Ids of stops that were requested and are not answered yet."""
        self._refused_s = -AGAIN_EVERY_S

    def hear(self, message: bytes, now_s: float, unix_s: float) -> tuple[Order | None, StopAnswer | None]:
        """Handle a message. Returns (order, answer): the stop to carry out now, if it is a new one, and the answer to
        publish now; both may be None."""
        try:
            order = levels.read_order(self._key, message)
        except signed.Forged as error:
            self.forged += 1
            self.last_forged = str(error)
            return None, None
        verdict = self._seen.judge(order.id, order.unix_s, unix_s)
        if verdict == replay.NEW:
            return order, None
        if verdict == replay.AGAIN:
            return None, self._again(order, now_s)
        if now_s - self._refused_s < AGAIN_EVERY_S:
            return None, None
        self._refused_s = now_s
        return None, StopAnswer(order.id, self._robot, {levels.REFUSED: 0.0}, verdict)

    def _again(self, order: Order, now_s: float) -> StopAnswer | None:
        """The answer to a stop that has come before. If this program was restarted since then, the answer only says
        that the stop was requested."""
        duty = self._duties.get(order.id)
        if duty is None:
            return StopAnswer(order.id, self._robot, {levels.ASKED: 0.0}, FORGOTTEN)
        if now_s - duty.told_s < AGAIN_EVERY_S:
            return None
        return self._answer(duty, now_s)

    def failed(self, order: Order, problem: str) -> StopAnswer:
        """The answer to a stop that could not be requested. The stop still counts as new, so it is tried again when the
        sender repeats it."""
        return StopAnswer(order.id, self._robot, {levels.FAILED: 0.0}, problem)

    def begin(self, order: Order, now_s: float, unix_s: float, before: State | None) -> None:
        """Follow a stop that was requested at `now_s`. `before`: the service's state before the request."""
        self._seen.obeyed(order.id, order.unix_s, unix_s)
        duty = self._duties[order.id] = Duty(order, now_s, unix_s, before)
        self._followed = [*self._followed, duty][-MOST_DUTIES:]
        while len(self._duties) > MOST_DUTIES:
            del self._duties[next(iter(self._duties))]
        self._new.append(order.id)

    def look(self, state: State | None, now_s: float) -> list[StopAnswer]:
        """The answers that are due because more has become known. The first answer of a stop says that it was
        requested."""
        new, self._new = self._new, []
        changed = [duty for duty in self._open(now_s) if duty.look(state, now_s) or duty.id in new]
        return [self._answer(duty, now_s) for duty in changed]

    def _answer(self, duty: Duty, now_s: float) -> StopAnswer:
        duty.told_s = now_s
        return StopAnswer(duty.id, self._robot, dict(duty.reached), duty.why, duty.confirms)

    def busy(self, now_s: float) -> bool:
        """True while more may become known about a stop."""
        return bool(self._open(now_s))

    def waits(self, now_s: float) -> bool:
        """True while a stop still has to be confirmed, because its sender waits for that."""
        return any(duty.confirms not in duty.reached for duty in self._open(now_s))

    def _open(self, now_s: float) -> list[Duty]:
        self._followed = [duty for duty in self._followed if duty.open(now_s)]
        return self._followed

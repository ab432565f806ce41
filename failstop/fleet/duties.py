"""Duties: decides which fleet stops this robot obeys, and which answers this robot sends to a fleet stop. Pure.

The publisher requests a stop from the service before it saves the stop's id. If the publisher crashes in between, the
robot may obey the stop twice. In the other order, a crash could lose the stop.
"""

from __future__ import annotations

from failstop.api import verdict
from failstop.fleet import levels, replay, signed
from failstop.fleet.levels import Order, StopAnswer
from failstop.policy.proofs import LINK_UNASKED

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State, Stop
    from failstop.fleet.replay import Seen

FOLLOWED_S = 6.0
"""How long the robot watches the progress of a stop, in seconds. After this time, no further proofs of the stop are
expected."""
AGAIN_EVERY_S = 0.25
"""The shortest time between two answers to a stop that its sender repeats, in seconds."""
MOST_DUTIES = 32
UNWRITTEN = "latched but NOT written, so the board did not get it"
FORGOTTEN = "requested, but then its publisher was restarted, so nobody knows whether the robot stopped"


class Duty:
    """One fleet stop that this robot carries out."""

    def __init__(self, order: Order, now_s: float, unix_s: float, before: State | None) -> None:
        """Make this right after the stop was requested from the service. `now_s`: time.monotonic(). `unix_s`: Unix
        time. `before`: the service's state before the request, or None if it could not be read."""
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
        """Find out from the service's state which levels the stop has reached. Returns True if one of them is new.

        If a stop was latched already, the service keeps the proofs of that stop. They count only as long as the present
        state does not contradict them."""
        stop = state.last_stop if state else None
        if state is None or stop is None or not self._answers_it(state, stop):
            return False
        is_older = self._epoch is not None and stop.epoch <= self._epoch
        if is_older and (why := verdict.doubt(state) or verdict.unproven(state)):
            self.why = why
            return False
        turns = state.turning.does == "turning"
        self.confirms = confirming(state)
        known = {
            levels.FAILED: stop.written_s is None,
            levels.WRITTEN: stop.written_s is not None and stop.sent and stop.believed,
            levels.ACKNOWLEDGED: stop.written_s is not None and stop.acknowledged_s is not None,
            levels.OBSERVED: stop.written_s is not None and stop.observed_s is not None and not turns,
        }
        new = {
            level: round(now_s - self._since_s, 4) for level, so in known.items() if so and level not in self.reached
        }
        self.reached |= new
        self.why = UNWRITTEN if known[levels.FAILED] else ""
        return bool(new)

    def _answers_it(self, state: State, stop: Stop) -> bool:
        """Return True if the service has obeyed this fleet stop. `stop`: the service's last stop.

        A new stop must have a newer epoch than the service had before the request. If that epoch is not known, the stop
        must not be older than the request.

        If a stop was latched already, the service makes no new stop. Then the service's own epoch must be newer than
        before the request.
        """
        if self._epoch is None:
            return stop.t >= self._unix_s
        was_latched = self._latched is not None and state.cause == self._latched
        return stop.epoch > self._epoch or (was_latched and state.epoch > self._epoch)

    def open(self, now_s: float) -> bool:
        """Return True until this stop has all its proofs (written, acknowledged, observed), but for at most
        FOLLOWED_S."""
        return now_s - self._since_s <= FOLLOWED_S and not set(levels.PROOFS) <= set(self.reached)


def confirming(state: State) -> str:
    """Return the level that confirms a fleet stop on this robot. It is ACKNOWLEDGED if the board can answer, else
    OBSERVED if the robot has an IMU, else WRITTEN."""
    if state.device.link != LINK_UNASKED:
        return levels.ACKNOWLEDGED
    return levels.OBSERVED if state.imu else levels.WRITTEN


class Duties:
    """Judges each message on the stop topic, and makes this robot's answers."""

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
        """The ids of stops that were requested but not answered yet."""
        self._refused_s = -AGAIN_EVERY_S

    def hear(self, message: bytes, now_s: float, unix_s: float) -> tuple[Order | None, StopAnswer | None]:
        """Judge a message. Returns (order, answer). The caller must request `order` from the service, or publish
        `answer`, at once. Either may be None."""
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
        """Return the answer to a stop that its sender repeats. None if the last answer was sent less than AGAIN_EVERY_S
        ago. For a stop that was requested before a restart of this program, the answer says only that it was
        requested."""
        duty = self._duties.get(order.id)
        if duty is None:
            return StopAnswer(order.id, self._robot, {levels.ASKED: 0.0}, FORGOTTEN)
        if now_s - duty.told_s < AGAIN_EVERY_S:
            return None
        return self._answer(duty, now_s)

    def failed(self, order: Order, problem: str) -> StopAnswer:
        """Return the answer to a stop that could not be requested. The stop still counts as new, so its next repeat is
        requested again."""
        return StopAnswer(order.id, self._robot, {levels.FAILED: 0.0}, problem)

    def begin(self, order: Order, now_s: float, unix_s: float, before: State | None) -> None:
        """Start to watch the progress of a stop that was requested at `now_s`. `before`: the service's state before the
        request."""
        self._seen.obeyed(order.id, order.unix_s, unix_s)
        duty = self._duties[order.id] = Duty(order, now_s, unix_s, before)
        self._followed = [*self._followed, duty][-MOST_DUTIES:]
        while len(self._duties) > MOST_DUTIES:
            del self._duties[next(iter(self._duties))]
        self._new.append(order.id)

    def look(self, state: State | None, now_s: float) -> list[StopAnswer]:
        """Return the answers that must be sent now: one for each stop that has a new level or was not answered yet. An
        answer has all levels that are known so far."""
        new, self._new = self._new, []
        changed = [duty for duty in self._open(now_s) if duty.look(state, now_s) or duty.id in new]
        return [self._answer(duty, now_s) for duty in changed]

    def _answer(self, duty: Duty, now_s: float) -> StopAnswer:
        duty.told_s = now_s
        return StopAnswer(duty.id, self._robot, dict(duty.reached), duty.why, duty.confirms)

    def busy(self, now_s: float) -> bool:
        """Return True while this robot watches the progress of any stop (see Duty.open())."""
        return bool(self._open(now_s))

    def waits(self, now_s: float) -> bool:
        """Return True while a stop has not reached the level that confirms it on this robot."""
        return any(duty.confirms not in duty.reached for duty in self._open(now_s))

    def _open(self, now_s: float) -> list[Duty]:
        self._followed = [duty for duty in self._followed if duty.open(now_s)]
        return self._followed

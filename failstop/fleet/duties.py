"""Duties: decides which fleet stops this robot obeys, and which answers this robot sends to a fleet stop. Pure.

The publisher requests a stop from the service before it saves the stop's id. If the publisher crashes in between, the
robot may obey the stop twice. In the other order, a crash could lose the stop.

A request can also be lost, or its latch can end, because the service is restarted at that moment. So the publisher asks
the next run of the service too.
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
"""How long the robot expects further proofs of a stop, in seconds."""
OWED_S = 60.0
"""How long the robot waits for the next run of its service, in seconds, if the run that was asked to stop has ended
while proofs were expected. The next run is then asked too, because a latched stop ends with its run. After this time,
only the sender's next repeat asks again."""
AGAIN_EVERY_S = 0.25
"""The shortest time between two answers to a stop that its sender repeats, in seconds. Also the shortest time between
two requests of the same stop."""
MOST_DUTIES = 32
UNWRITTEN = "latched but NOT written, so the board did not get it"
ENDED = "its service has ended since, and the latched stop with it"
FORGOTTEN = "requested, but then its publisher was restarted, so nobody knows whether the robot stopped"


class Duty:
    """One fleet stop that this robot carries out."""

    def __init__(self, order: Order, now_s: float, before: State | None, run: str) -> None:
        """Make this right after the stop was requested from the service. `now_s`: time.monotonic(). `before`: the
        service's state before the request, or None if it could not be read. `run`: the run of the service that has this
        state, or empty."""
        self.order = order
        self.reached: dict[str, float] = {levels.ASKED: 0.0}
        self.why = ""
        """Why the stop was not written, or what contradicts the levels that it has reached. Otherwise empty."""
        self.confirms = levels.ACKNOWLEDGED
        self.observes = True
        """False once it is known that this robot will not observe its wheels after this stop (see observing())."""
        self.heard = False
        """True if the service has obeyed the stop."""
        self.lost = False
        """True if the run that was asked to stop has ended, and nobody had reset the stop. Its latch has then ended
        with it, and if it had not obeyed the stop yet, it never will. Also True if it is not known which run was
        asked, because the state could not be read."""
        self.told_s = self.asked_s = now_s
        self._since_s = now_s
        self._run = run
        self._epoch = before.epoch if before else 0
        self._latched = before.cause if before else None
        self._was_latched = self._reset = False
        self._owes = False
        """True if the run that was asked to stop has ended while proofs were expected."""

    def look(self, state: State | None, now_s: float, run: str) -> bool:
        """Find out from the service's state which levels the stop has reached, and whether anything contradicts them.
        Returns True if the robot's answer has changed. `run`: the run that has this state, or empty."""
        before = self._gist()
        self.lost = (run != self._run or not run) and not self._reset
        self._owes = self.lost and self._expects(now_s)
        if self.lost:
            self.why = ENDED if self._run else ""
        elif run == self._run and state is not None:
            self._judge(state, now_s)
        return self._gist() != before

    def _gist(self) -> tuple[object, ...]:
        """Return the parts of the answer whose change must be reported. The text of `why` may contain a duration, which
        changes with every look."""
        return set(self.reached), bool(self.why), self.confirms, self.observes

    def _judge(self, state: State, now_s: float) -> None:
        """If a stop was latched already, the service keeps the proofs of that stop. They count only as long as the
        present state does not contradict them."""
        stop = state.last_stop
        self._reset = self._reset or (self._was_latched and state.cause is None)
        if self._reset:
            self.why = ""  # a person has taken over, so what the wheels do now says nothing about the stop
        if self._reset or stop is None or not self._answers_it(state, stop):
            return
        self.heard = True
        self._was_latched = self._was_latched or state.cause is not None
        is_older = stop.epoch <= self._epoch
        self.why = verdict.doubt(state)
        if is_older:
            self.why = self.why or verdict.unproven(state)
            if self.why:
                return
        self.confirms, self.observes = confirming(state, stop), observing(state, stop)
        known = {
            levels.FAILED: stop.written_s is None,
            levels.WRITTEN: stop.written_s is not None and stop.sent and stop.believed,
            levels.ACKNOWLEDGED: stop.written_s is not None and stop.acknowledged_s is not None,
            levels.OBSERVED: stop.written_s is not None and _observed(state, stop, is_older=is_older),
        }
        for level, so in known.items():
            if so:
                self.reached.setdefault(level, round(now_s - self._since_s, 4))
        self.why = UNWRITTEN if known[levels.FAILED] else self.why

    def _answers_it(self, state: State, stop: Stop) -> bool:
        """Return True if the service has obeyed this fleet stop. `stop`: the service's last stop.

        A new stop must have a newer epoch than the service had before the request.

        If a stop was latched already, the service makes no new stop. Then the service's own epoch must be newer than
        before the request.
        """
        was_latched = self._latched is not None and state.cause == self._latched
        return stop.epoch > self._epoch or (was_latched and state.epoch > self._epoch)

    def followed(self, now_s: float) -> bool:
        """Return True while this stop must be looked at: as long as its sender may wait for answers."""
        return now_s - self._since_s <= levels.LONGEST_S

    def _expects(self, now_s: float) -> bool:
        """Return True while further proofs, or the next run of the service, are expected."""
        return now_s - self._since_s <= (OWED_S if self._owes else FOLLOWED_S)

    def open(self, now_s: float) -> bool:
        """Return True while the answer to this stop will change soon: until the stop has all the proofs that this robot
        can give, or while it must be requested from the next run."""
        observed = levels.OBSERVED in self.reached or not self.observes
        complete = observed and {levels.WRITTEN, levels.ACKNOWLEDGED} <= set(self.reached)
        return self._expects(now_s) and (self.lost or not complete)

    def owed(self, now_s: float, run: str) -> bool:
        """Return True if the stop must be requested from this run of the service, because the run that was asked has
        ended. False after a person has reset the stop."""
        return self._expects(now_s) and run not in ("", self._run) and not self._reset


def confirming(state: State, stop: Stop) -> str:
    """Return the level that confirms a fleet stop on this robot. It is ACKNOWLEDGED if the board answers questions, or
    if it has acknowledged this stop in another way. Otherwise it is OBSERVED if the robot can observe its wheels, else
    WRITTEN."""
    if state.device.link != LINK_UNASKED or stop.acknowledged_s is not None:
        return levels.ACKNOWLEDGED
    return levels.OBSERVED if observing(state, stop) else levels.WRITTEN


def observing(state: State, stop: Stop) -> bool:
    """Return True if this robot has observed, or may still observe, that its wheels have come to rest after this stop.
    An IMU can't do that if it felt no motion before the stop either."""
    if stop.observed_by == "IMU" and state.imu is None:
        return False
    return bool(stop.observed_by) and (stop.observed_s is None or verdict.observed(stop))


def _observed(state: State, stop: Stop, *, is_older: bool) -> bool:
    """Return True if the wheels have been observed to be still. After a stop that was latched before the request, they
    must be seen still now."""
    does = state.turning.does
    return verdict.observed(stop) and (does == "still" if is_older else does != "turning")


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
        judged = self._seen.judge(order.id, order.unix_s, unix_s)
        if judged == replay.NEW:
            return order, None
        if judged == replay.AGAIN:
            if self._unheard(order, now_s, unix_s):
                return order, None
            return None, self._again(order, now_s)
        if now_s - self._refused_s < AGAIN_EVERY_S:
            return None, None
        self._refused_s = now_s
        return None, StopAnswer(order.id, self._robot, {levels.REFUSED: 0.0}, judged)

    def _unheard(self, order: Order, now_s: float, unix_s: float) -> bool:
        """Return True if a stop that its sender repeats must be requested once more, because the service may not have
        heard the first request: nobody reads the stop pipe of a run that is ending. A stop that the service has obeyed
        is not requested again, because a person may have reset it since. A recorded message has an old date, so it
        never works a second time."""
        if not self._seen.repeated(order.id, order.unix_s, unix_s):
            return False
        duty = self._duties.get(order.id)
        if duty is None:  # requested by an earlier run of this program, which did not find out what became of it
            return True
        if (duty.heard and not duty.lost) or now_s - duty.asked_s < AGAIN_EVERY_S:
            return False
        duty.asked_s = now_s
        return True

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

    def begin(self, order: Order, now_s: float, unix_s: float, before: State | None, run: str) -> None:
        """Start to watch the progress of a stop that was requested at `now_s`, perhaps not for the first time.
        `before`: the service's state before the request. `run`: the run of the service that has this state, or empty if
        it could not be read."""
        self._seen.obeyed(order.id, order.unix_s, unix_s)
        others = [duty for duty in self._followed if duty.order.id != order.id]
        duty = self._duties[order.id] = Duty(order, now_s, before, run)
        self._followed = [*others, duty][-MOST_DUTIES:]
        while len(self._duties) > MOST_DUTIES:
            del self._duties[next(iter(self._duties))]
        self._new.append(order.id)

    def owed(self, now_s: float, run: str) -> list[Order]:
        """Return the stops that must be requested from this run of the service, because the run that was asked has
        ended (see Duty.owed()). Call this before look()."""
        return [duty.order for duty in self._kept(now_s) if duty.owed(now_s, run)]

    def look(self, state: State | None, now_s: float, run: str) -> list[StopAnswer]:
        """Return the answers that must be sent now: one for each stop whose answer has changed, or that was not
        answered yet. An answer has all levels that are known so far. `run`: the run of the service that has this state,
        or empty."""
        new, self._new = self._new, []
        changed = [duty for duty in self._kept(now_s) if duty.look(state, now_s, run) or duty.order.id in new]
        return [self._answer(duty, now_s) for duty in changed]

    def _answer(self, duty: Duty, now_s: float) -> StopAnswer:
        duty.told_s = now_s
        found = dict(duty.reached), duty.why, duty.confirms
        return StopAnswer(duty.order.id, self._robot, *found, observes=duty.observes)

    def busy(self, now_s: float) -> bool:
        """Return True while this robot watches the progress of any stop (see Duty.open())."""
        return any(duty.open(now_s) for duty in self._kept(now_s))

    def waits(self, now_s: float) -> bool:
        """Return True while a stop has not reached the level that confirms it on this robot, and its run lives."""
        kept = self._kept(now_s)
        return any(duty.open(now_s) and not duty.lost and duty.confirms not in duty.reached for duty in kept)

    def _kept(self, now_s: float) -> list[Duty]:
        self._followed = [duty for duty in self._followed if duty.followed(now_s)]
        return self._followed

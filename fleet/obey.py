"""Obey: the stops of the fleet on the robot's side: which are obeyed, and what is answered when. Pure.

A stop is asked for first and remembered after: what a crash between the two lets through is a stop too many.
"""

from __future__ import annotations

from failstop.fleet import levels, replay, signed
from failstop.fleet.levels import Answer, Order

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State, Stop
    from failstop.fleet.replay import Seen

FOLLOWED_S = 6.0
"""By then all is known that will be known of a stop."""
AGAIN_EVERY_S = 0.25
"""An id that comes again is answered this often at most."""
MOST_DUTIES = 32


class Duty:
    """One stop that this robot carries out."""

    def __init__(self, order: Order, robot: str, now_s: float, unix_s: float, epoch: int | None) -> None:
        """`now_s`: monotonic; `epoch`: the service's before it was asked, None where that was not to be read."""
        self.order = order
        self.answers: list[Answer] = []
        """All that were given."""
        self.told_s = now_s
        self._robot = robot
        self._since_s = now_s
        self._unix_s = unix_s
        self._epoch = epoch

    def asked(self, problem: str, now_s: float) -> list[Answer]:
        """The request went into the pipe, or there is a problem."""
        return [self._answer(levels.FAILED if problem else levels.ASKED, problem, now_s)]

    def look(self, state: State | None, now_s: float) -> list[Answer]:
        """What has become known of it."""
        stop = state.last_stop if state else None
        if stop is None or not self._answers_it(stop):
            return []
        told = {answer.level for answer in self.answers}
        if stop.written_s is None:
            text = "latched, but NOT written: the board did not get it"
            return [] if levels.FAILED in told else [self._answer(levels.FAILED, text, now_s)]
        known = {
            levels.WRITTEN: True,
            levels.ACKNOWLEDGED: stop.acknowledged_s is not None,
            levels.OBSERVED: stop.observed_s is not None,
        }
        return [self._answer(level, "", now_s) for level, there in known.items() if there and level not in told]

    def _answers_it(self, stop: Stop) -> bool:
        """A stop of before the request is no answer to it; whichever came after it is."""
        return stop.t >= self._unix_s if self._epoch is None else stop.epoch > self._epoch

    def over(self, now_s: float) -> bool:
        """Nothing more will be known of it."""
        return now_s - self._since_s > FOLLOWED_S

    def complete(self) -> bool:
        """Every proof is there."""
        return set(levels.PROOFS) <= {answer.level for answer in self.answers}

    def _answer(self, level: str, why: str, now_s: float) -> Answer:
        found = Answer(self.order.id, self._robot, level, why, round(now_s - self._since_s, 4))
        self.answers.append(found)
        return found


class Obedience:
    """What the robot does with messages on the stop topic."""

    def __init__(self, key: bytes, robot: str, seen: Seen) -> None:
        self.forged = 0
        """Messages that were not the fleet's."""
        self.last_forged = ""
        self._key = key
        self._robot = robot
        self._seen = seen
        self._duties: dict[str, Duty] = {}
        self._refused_s = 0.0

    def hear(self, message: bytes, now_s: float, unix_s: float) -> tuple[Order | None, list[Answer]]:
        """A message came: the stop to carry out now, if it is a new one, and what to answer."""
        try:
            order = levels.read_order(self._key, message)
        except signed.Forged as error:
            self.forged += 1
            self.last_forged = str(error)
            return None, []
        verdict = self._seen.judge(order.id, order.unix_s, unix_s)
        if verdict == replay.NEW:
            return order, []
        if verdict == replay.AGAIN:
            return None, self._again(order, now_s)
        if now_s - self._refused_s < AGAIN_EVERY_S:
            return None, []
        self._refused_s = now_s
        return None, [Answer(order.id, self._robot, levels.REFUSED, verdict, 0.0)]

    def _again(self, order: Order, now_s: float) -> list[Answer]:
        """What was answered before; of a stop from before a restart, that it was."""
        duty = self._duties.get(order.id)
        if duty is None:
            text = "obeyed before this program was started anew: what became of it is not known here"
            return [Answer(order.id, self._robot, levels.ASKED, text, 0.0)]
        if now_s - duty.told_s < AGAIN_EVERY_S:
            return []
        duty.told_s = now_s
        return duty.answers

    def begin(self, order: Order, problem: str, now_s: float, unix_s: float, epoch: int | None) -> list[Answer]:
        """It was asked for, at `now_s` and in `epoch` or later; what to answer. A problem keeps it new: it is tried
        again when the sender repeats it."""
        duty = Duty(order, self._robot, now_s, unix_s, epoch)
        found = duty.asked(problem, now_s)
        if not problem:
            self._seen.obeyed(order.id, order.unix_s, unix_s)
            self._duties[order.id] = duty
            while len(self._duties) > MOST_DUTIES:
                del self._duties[next(iter(self._duties))]
        return found

    def look(self, state: State | None, now_s: float) -> list[Answer]:
        """What has become known of those that are carried out."""
        return [answer for duty in self._open(now_s) for answer in duty.look(state, now_s)]

    def busy(self, now_s: float) -> bool:
        """True while more is to be known of one."""
        return bool(self._open(now_s))

    def _open(self, now_s: float) -> list[Duty]:
        return [duty for duty in self._duties.values() if not (duty.over(now_s) or duty.complete())]

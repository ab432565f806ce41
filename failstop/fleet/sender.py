"""Sender: a stop of the whole fleet, repeated until every robot has confirmed it or the time is over."""

from __future__ import annotations

import dataclasses
import json
import secrets
import time

from failstop.api import words
from failstop.fleet import FleetError, levels, settings, signed, topics
from failstop.fleet.broker import Broker
from failstop.fleet.levels import Order
from failstop.fleet.repeats import MANY, Repeats
from failstop.fleet.tally import Tally

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.fleet.settings import FleetSettings

OBSERVED_S = 2.5
"""How long to go on for the third proof when all have confirmed."""
TURN_S = 0.05


class Sender:
    """One stop."""

    def __init__(self, found: FleetSettings, reason: str, by: str) -> None:
        """Raises FleetError."""
        self.id = secrets.token_hex(16)
        self.tally = Tally(settings.robots(found))
        self.sent_s: float | None = None
        """When it was handed to the broker first, monotonic."""
        self._key = signed.read_key(found.text("stop.key_file"))
        self._order = Order(self.id, 0.0, reason, by)
        self._manufacturer = found.text("robot.manufacturer")
        self._probe = topics.answer(self._manufacturer, self.id, "probe/end")
        self.heard_all = False
        """The broker has said whom it knows."""
        self._repeats = Repeats()
        wanted = (
            topics.answer(self._manufacturer, self.id, topics.ANY),
            topics.of_robot(self._manufacturer, topics.ANY, topics.CONNECTION),
            self._probe,
        )
        # All at once, from a thousand robots: what is lost all the same, the next sending is answered with.
        self.broker = Broker(found, f"failstop-stop-{self.id[:12]}", wanted, self._hear, self._up)

    def run(self, wait_s: float, progress: Callable[[Tally], None] = lambda _: None) -> bool:
        """Send until all have confirmed, `wait_s` at most; returns whether they did. Raises FleetError when no broker
        took it."""
        until_s = time.monotonic() + wait_s
        enough_s = until_s
        while (now_s := time.monotonic()) < min(until_s, enough_s):
            if self._repeats.due(now_s):
                self._send(now_s)
            self.broker.turn(TURN_S)
            progress(self.tally)
            if self.heard_all and self.tally.all_confirmed():
                if self.tally.all_reached(levels.OBSERVED):
                    break
                enough_s = min(enough_s, now_s + OBSERVED_S)
            else:
                enough_s = until_s
        self.broker.close()
        if self.sent_s is None:
            raise FleetError(f"NO ROBOT WAS STOPPED: {self.broker.problem}; stop them by hand (power switch)")
        return self.heard_all and self.tally.all_confirmed()

    def _up(self) -> None:
        self._send(time.monotonic())
        self.broker.say(self._probe, b"end")

    def _send(self, now_s: float) -> None:
        """To all; then to the robots that have not confirmed, one by one, unless most are missing."""
        if self.broker.problem:
            return
        message = dataclasses.replace(self._order, unix_s=time.time()).message(self._key)
        missing = [row.robot for row in self.tally.missing()]
        most = len(missing) > max(MANY, len(self.tally.robots()) // 2)
        some = self.sent_s is not None and self.heard_all and not most
        self._repeats.sent(now_s, len(missing))
        self.sent_s = self.sent_s or now_s
        for robot in missing if some else ("",):
            self.broker.say(topics.stop(self._manufacturer, robot), message)

    def _hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        if topic == self._probe:
            self.heard_all = True
            return
        robot, last = topics.robot_of(topic)
        if last == topics.CONNECTION:
            self.tally.connection(words.printable(robot), connection_word(payload))
            return
        try:
            answer = levels.read_answer(self._key, payload)
        except signed.Forged:
            return  # nobody's word for it
        now_s = time.monotonic()
        if answer.id == self.id and self.sent_s is not None and self.tally.answer(answer, now_s - self.sent_s):
            self._repeats.heard(now_s)


def connection_word(payload: bytes) -> str:
    """The state in a connection message; empty for one that was taken away, or is none."""
    try:
        return str(json.loads(payload)["connectionState"]) if payload else ""
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""

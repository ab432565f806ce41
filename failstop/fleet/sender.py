"""Sender: sends a fleet stop, and repeats it until every robot has confirmed it or the time is over."""

from __future__ import annotations

import dataclasses
import secrets
import time

from failstop.api import words
from failstop.fleet import FleetError, levels, settings, signed, topics
from failstop.fleet.broker import LONGEST_PAUSE_S, Broker
from failstop.fleet.levels import MOST_TEXT, Order
from failstop.fleet.repeats import MANY, Repeats
from failstop.fleet.tally import STABLE_S, Tally
from failstop.fleet.twins import connection_of

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.fleet.settings import FleetSettings

OBSERVED_S = 2.5
"""How long the sender waits until all robots that can observe their wheels have seen that they are still, s. This time
begins when all robots have confirmed the stop. It is longer than the setting still.after_s, after which a robot reports
that its wheels still turn."""
WAIT_S = 5.0
"""How long to wait for robots that have not confirmed, s, if --wait is not given."""
TURN_S = 0.05
BY_HAND = "stop them by hand (power switch)"


class Sender:
    """Sends one fleet stop."""

    def __init__(self, found: FleetSettings, reason: str, by: str) -> None:
        """Raises FleetError."""
        self.id = secrets.token_hex(16)
        listed, self._unlisted = None, ""
        # The list is only for counting, so a flaw in it must not keep the stop from the robots.
        try:
            listed = settings.robots(found)
        except FleetError as error:
            self._unlisted = str(error)
        self.listed = listed is not None
        """True if a file names the robots that must confirm."""
        self.tally = Tally(listed)
        self.sent_s: float | None = None
        """When the stop was first given to the broker (time.monotonic(), s). None before that."""
        self.doubts: tuple[str, ...] = ()
        """Reasons to think that more robots exist than the tally has counted. They are known after run(). Empty if no
        such reason is known."""
        self._key = signed.read_key(found.text("stop.key_file"))
        self._order = Order(self.id, 0.0, reason, by)
        self._fleet = found.text("robot.fleet")
        self._away_s = LONGEST_PAUSE_S + found.number("robot.publish_s")
        """How long a robot may take to connect again after a restart of the broker, s. The robot notices the restart
        when it sends its next state message, and may then need several attempts."""
        self._probe = topics.answer(self._fleet, self.id, "probe/end")
        self.heard_all = False
        """True once the broker has named all robots that it remembers. False again after each new connection to the
        broker."""
        self._repeats = Repeats()
        self._connections = topics.of_robot(self._fleet, topics.ANY, topics.CONNECTION)
        wanted = (topics.answer(self._fleet, self.id, topics.ANY), self._connections, self._probe)
        # A thousand robots answer at once. If an answer is lost, the robot answers again to the next sending.
        self.broker = Broker(found, f"failstop-stop-{self.id[:12]}", wanted, self._hear, self._up)

    def run(self, wait_s: float | None = None, progress: Callable[[], None] = lambda: None) -> bool:
        """Send the stop, and repeat it until all robots have confirmed it or the time is over. Returns True if all
        known robots have confirmed the stop and `doubts` is empty. Raises FleetError if the stop could not be given to
        the broker.

        `wait_s`: the longest time to wait. The default is WAIT_S, or longer while robots may still be reconnecting
        after a restart of the broker. `progress` is called again and again during the wait.
        """
        until_s = time.monotonic() + (WAIT_S if wait_s is None else wait_s)
        confirmed_s: float | None = None
        try:
            while True:
                now_s = time.monotonic()
                limit_s = until_s
                if not self._all_confirmed():
                    confirmed_s = None
                else:
                    confirmed_s = now_s if confirmed_s is None else confirmed_s
                    late = bool(self._late(now_s))
                    observed = not self.tally.unobserved() or now_s - confirmed_s >= OBSERVED_S
                    if observed and not late:
                        break
                    if late and wait_s is None:
                        limit_s = max(until_s, self.broker.up_s + self._away_s + TURN_S)
                if now_s >= limit_s:
                    break
                if self._repeats.due(now_s):
                    self._send(now_s)
                self.broker.turn(TURN_S)
                progress()
        finally:
            self.doubts = tuple(self._doubts(time.monotonic()))
            self.broker.close()
        if self.sent_s is None:
            raise FleetError(f"NO ROBOT WAS STOPPED: {self.broker.problem}; {BY_HAND}")
        return self._all_confirmed() and not self.doubts

    def _all_confirmed(self) -> bool:
        return self.heard_all and self.tally.all_confirmed()

    def _late(self, now_s: float) -> str:
        """Return why the count of robots may be wrong: robots may still be connecting after a restart of the broker, or
        a connection may keep breaking. Otherwise empty."""
        after_s = now_s - (self.sent_s or now_s)
        oldest_s = self.tally.oldest_s()
        if self.broker.connected_s() < self._away_s and (oldest_s is None or after_s - oldest_s < self._away_s):
            return (
                f"the broker may have been restarted less than {self._away_s:.0f} s ago, and a robot may need that "
                "long to connect again: stop them again, and list your robots in stop.robots_file"
            )
        if young := self.tally.young(after_s):
            return (
                f"{young[0]} connected less than {STABLE_S:g} s before it answered, so its connection may "
                "break again and again: stop them again"
            )
        return ""

    def _doubts(self, now_s: float) -> list[str]:
        """Return all reasons why robots may be missing from the count."""
        found = []
        if self.sent_s is not None and self.broker.problem:
            found.append(f"the connection was lost in the meantime: {self.broker.problem}")
        elif self.sent_s is None:
            return found
        if self._unlisted:
            found.append(self._unlisted)
        if denied := self.broker.denied:
            found.append(f"the broker does not let you read {' and '.join(denied)}: check its access list")
        elif not self.heard_all and not self.broker.problem:
            found.append(
                "the broker may not have listed every robot that it remembers: its access list must let you read "
                f"and write failstop/v1/{self._fleet}/#"
            )
        if hidden := self.tally.hidden():
            found.append(
                f"{hidden[0]} answered, but the broker does not show you its connection, so it may hide robots that do "
                f"not answer: its access list must let you read {self._connections}"
            )
        if self._all_confirmed() and (late := self._late(now_s)):
            found.append(late)
        return found

    def _up(self) -> None:
        self.heard_all = False
        self.tally.reconnected()
        self._send(time.monotonic())
        self.broker.say(self._probe, b"end")

    def _send(self, now_s: float) -> None:
        """Send the stop to the missing robots, one by one. The stop goes to all robots at once in three cases:

        - The stop is sent for the first time.
        - More than MANY robots are missing, and more than half of all robots.
        - The broker may know more robots than it has named, or it hides robots. It may hide one if a robot answered, or
          is listed in stop.robots_file, and the broker never named that robot.
        """
        if self.broker.problem:
            return
        message = dataclasses.replace(self._order, unix_s=time.time()).message(self._key)
        missing, robots = [row.robot for row in self.tally.missing()], self.tally.robots()
        most = len(missing) > max(MANY, len(robots) // 2)
        hides = bool(self.tally.hidden() or self.tally.unnamed())
        some = self.sent_s is not None and self.heard_all and not most and not hides
        self._repeats.sent(now_s, len(missing if some else robots))  # a robot that has confirmed answers again too
        self.sent_s = self.sent_s or now_s
        for robot in missing if some else ("",):
            self.broker.say(topics.stop(self._fleet, robot), message)

    def _hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        if topic == self._probe:
            self.heard_all = True
            return
        robot, last = topics.robot_of(topic)
        if last == topics.CONNECTION:
            said = connection_of(payload)
            self.tally.connection(words.printable(robot[:MOST_TEXT])[:MOST_TEXT], said.word, said.number)
            return
        try:
            answer = levels.read_answer(self._key, payload)
        except signed.Forged:
            return  # it is not signed by a robot of this fleet
        now_s = time.monotonic()
        if answer.id == self.id and self.sent_s is not None and self.tally.answer(answer, now_s - self.sent_s):
            self._repeats.heard(now_s)

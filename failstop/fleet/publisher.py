"""Publisher: publishes this robot's connection, state and events on the broker, and carries out fleet stops.

The robot works without its publisher, and the publisher can't move the robot. The publisher has no special rights. The
publisher requests stops through the service's stop pipe, to which every local user may write. From the service, the
publisher reads only what every user may read.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time

from failstop.api import words
from failstop.api.client import send_stop
from failstop.api.errors import FailstopError
from failstop.api.events import EventLog
from failstop.api.state import StateReader
from failstop.cli import standard
from failstop.files import durable
from failstop.files.root import state_directory
from failstop.fleet import FleetError, message, signed, topics
from failstop.fleet.broker import ANYHOW, Broker
from failstop.fleet.duties import Duties
from failstop.fleet.replay import Seen
from failstop.fleet.settings import KEY, PLACE
from failstop.fleet.twins import Twins, draw
from failstop.messages import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, Protocol

    from failstop.api.events import Event
    from failstop.api.state import State
    from failstop.fleet.levels import Order, StopAnswer
    from failstop.fleet.settings import FleetSettings

    class Robot(Protocol):
        """The robot's service, as the publisher uses it."""

        run: str
        """Identifies the run of the service that the last read() has read. Empty if there was none."""

        def read(self) -> State | FailstopError: ...
        def events(self) -> list[Event]: ...
        def stop(self, reason: str, by: str) -> str: ...


LOOK_S = 0.2
"""The time between two looks at the robot's state, s."""
BUSY_LOOK_S = 0.02
"""The time between two looks while a fleet stop is not confirmed yet, s."""
LAST_LOOK_S = 0.1
"""The time between two looks while a fleet stop is confirmed but not all of its proofs are known, s. It is longer than
BUSY_LOOK_S, because the sender of the stop no longer waits for this robot."""
BUSY_STATE_S = 1.0
"""The time between two state messages during a fleet stop, s. It is long, because frequent state messages of a thousand
robots would delay the robots' answers to the stop."""
FIRST_LOOK_S = 0.003
"""The time from the request of a stop to the first look at the robot's state, s. By then the service has usually
written the stop to the board, so the first answer can already report that the stop is written."""
CHANGES_S = 1.0
"""The shortest time between two state messages if only values such as a velocity have changed, s."""
MOST_EVENTS = 20
"""The largest number of events that are published at one look. If there are more new events, only the newest are
published. The journal has all of them."""
FORGED_S = 60.0
"""How long a forged stop is reported as an error after it has arrived, s. A forged stop is one that was not signed with
the fleet's key."""
CLOSE_S = 1.5
"""How long close() waits until the broker has confirmed the message that this robot is offline, s."""
SEEN = "fleet-stops.json"
NOT_LISTENING = "the broker has not answered the subscription yet"


def _state(found: State | FailstopError) -> State | None:
    return None if isinstance(found, FailstopError) else found


def _body(found: State | FailstopError, extra: tuple[message.Message, ...]) -> message.Message:
    if isinstance(found, FailstopError):
        return message.without_state(found, extra)
    return message.body(found, extra)


class Service:
    """The robot's service on this computer. If the service is restarted, the next call finds its new run."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.run = ""
        """Identifies the run of the service that the last read() has read. Empty if there was none."""
        self._reader: StateReader | None = None
        self._log: EventLog | None = None
        self._log_ended = ""
        """The run whose events have all been returned. It can still be found for a moment after its supervisor was
        killed."""

    def read(self) -> State | FailstopError:
        """Return the present state, or the error for which it can't be read."""
        for _ in range(2):  # if the run that was read has ended, try the next run
            try:
                if self._reader is None or self._reader.over():
                    self._reader = StateReader(self.name)
                state, self.run = self._reader.read(), self._reader.found[0]
                return state
            except FailstopError as error:
                self._reader, problem = None, error
        self.run = ""
        return problem

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        try:
            log = self._log or EventLog(self.name)
        except FailstopError:
            return []
        if log.run == self._log_ended:
            return []
        try:
            self._log = log
            return log.read()
        except FailstopError:
            self._log, self._log_ended = None, log.run
            return []

    def stop(self, reason: str, by: str) -> str:
        """Request a stop. Returns an error text, or ""."""
        try:
            send_stop(self.name, reason, f"{records.FLEET_PREFIX}{by}")
        except FailstopError as error:
            return str(error)
        return ""


class Publisher:
    """Publishes this robot and carries out fleet stops. Call turn() in an endless loop."""

    def __init__(self, settings: FleetSettings, name: str, robot: Robot, robot_id: str, store: str) -> None:
        """`robot`: the robot's service. `robot_id`: the robot's name in the fleet. `store`: the folder of the file with
        the stops that were obeyed. Raises FleetError."""
        fleet = settings.text("robot.fleet")
        self.robot_id = robot_id
        self._robot = robot
        self._fleet = fleet
        self._publish_s = settings.number("robot.publish_s")
        self.number = draw()
        """This publisher's random number. All its messages contain it."""
        self.twins = Twins(self.number, time.time())
        self._header = message.Header(fleet, robot_id, self.number)
        self._connection_topic = self._header.topic(topics.CONNECTION)
        self._stop_topic = topics.stop(fleet)
        self._key, self._off = _key(settings)
        self._store = os.path.join(store, SEEN)
        self._seen = _remembered(self._store, settings.number("stop.tolerance_s"))
        self.duties = Duties(self._key, robot_id, self._seen)
        """Judges messages that claim to be fleet stops. A robot without the fleet's key ignores such messages, and does
        not have them judged."""
        self.unsaved = False
        """True while the newest obeyed stops are not saved. The publisher saves them after it has sent its answers,
        because the disk may be slow."""
        self._said_forged = 0
        self._said_refuses = self._said_doubled = ""
        self._forged_s = -FORGED_S
        self._look_at_s = self._published_s = self._built_s = 0.0
        self._shown: tuple[object, object] = (None, None)
        self._word = message.ONLINE
        """The state of this robot's connection, message.ONLINE or OFFLINE. It is published at each new connection to
        the broker."""
        # The number makes the client's name unique. Otherwise two robots of one name would end each other's connection.
        name = f"failstop-{robot_id}-{self.number}"
        wanted = (*self._stop_topics(), self._connection_topic)
        self.broker = Broker(settings, name, wanted, self._hear, self._up, newest_first=True)
        self._will()

    def _stop_topics(self) -> tuple[str, str]:
        return self._stop_topic, topics.stop(self._fleet, self.robot_id)

    def turn(self, longest_s: float = LOOK_S) -> None:
        """Wait for messages until the next look is due, but at most `longest_s`. Handle the messages, then call look().
        Without a connection, this may take longer (see Broker.turn())."""
        was = self.broker.problem
        self.broker.turn(min(longest_s, max(0.0, self._look_at_s - time.monotonic())))
        # With a second publisher of this name this is not logged: they may end each other's connection every second.
        if self.broker.problem != was and not self.twins.others:
            standard.say(
                self.broker.problem or f"the broker at {self.broker.where} knows this robot as {self.robot_id}"
            )
        if (refuses := self._refuses()) != self._said_refuses:
            self._said_refuses = refuses
            if refuses:
                standard.say(f"WARNING: this robot obeys no fleet stop: {refuses}")
        if (doubled := self.doubled()) != self._said_doubled:
            self._said_doubled = doubled
            standard.say(f"WARNING: {doubled}")
        self.look(time.monotonic())

    def look(self, now_s: float) -> None:
        """Publish what has changed, if the next look is due."""
        if now_s < self._look_at_s:
            return
        if self.twins.again:
            self.twins.again = False
            self._connection()
            self._will()
        busy = self.busy(now_s)
        found = self._robot.read()
        state = _state(found)
        run = self._robot.run
        for order in self.duties.owed(now_s, run):
            if not self._ask(order, state, run, now_s, time.time()):
                _log(order, "asked for again, because the service was restarted")
        for answer in self.duties.look(state, now_s, run):
            self._answer(answer)
        self._look_at_s = now_s + (self._soon_s(now_s) if busy else LOOK_S)
        if busy and now_s - self._built_s < BUSY_STATE_S:
            return
        self._built_s = now_s
        self._publish(found, now_s)
        if self.unsaved and not self.broker.wants_write():
            self.unsaved = False
            self._remember()
        if not self.broker.problem:
            for event in self._robot.events()[-MOST_EVENTS:]:
                self._publish_event(event)

    def deaf(self) -> str:
        """Return why this robot would not obey a fleet stop now. Empty if it would."""
        refuses = self._off or self.broker.problem or self._refuses()
        return refuses or ("" if self.broker.listening else NOT_LISTENING)

    def _refuses(self) -> str:
        """Return why this robot would obey no fleet stop although it is connected. Empty if it would."""
        return self._denied() or self._set_back()

    def _denied(self) -> str:
        denied = " and ".join(topic for topic in self.broker.denied if topic in self._stop_topics())
        return f"the broker does not let this robot read {denied}: check its access list" if denied else ""

    def _set_back(self) -> str:
        """Return until when this robot refuses every stop because its clock was set back, and what to do. Otherwise
        empty."""
        until_s = self._seen.floor_s
        if until_s < time.time():
            return ""
        return (
            f"it refuses every fleet stop until {words.clock(until_s)}, because its clock was set back: once the clock "
            f"is right, remove {self._store} and restart the publisher"
        )

    def doubled(self) -> str:
        """Return a warning if another publisher uses this robot's name, with what to do. Otherwise empty."""
        if not self.twins.others:
            return ""
        return (
            f"another publisher also calls itself {self.robot_id}, so no fleet stop counts this robot as confirmed: "
            f"give each robot its own robot.id in {PLACE}, then restart both publishers "
            "(`systemctl restart failstop-fleet`)"
        )

    def busy(self, now_s: float) -> bool:
        """Return True while this robot watches the progress of a fleet stop."""
        return self.duties.busy(now_s)

    def _soon_s(self, now_s: float) -> float:
        return BUSY_LOOK_S if self.duties.waits(now_s) else LAST_LOOK_S

    def close(self) -> None:
        """End cleanly: publish that the robot is offline, so that it does not count as lost. If the broker does not
        confirm this message within CLOSE_S, drop the connection. Then the broker publishes the last will."""
        self._word = message.OFFLINE
        self._connection()
        if self.broker.confirmed(CLOSE_S):
            self.broker.close()
        else:
            standard.say(
                f"the broker at {self.broker.where} did not confirm that this robot signed off, so it shows it as lost"
            )
            self.broker.drop()
        if self.unsaved:
            self._remember()

    def _will(self) -> None:
        body = message.connection(message.LOST, heard=self.twins.heard())
        self.broker.will(self._connection_topic, self._header.message(topics.CONNECTION, body, time.time()))

    def _up(self) -> None:
        self.twins.connected()
        self._connection()
        self._will()  # with a new date, for the next connection
        self._shown = (None, None)
        self._look_at_s = 0.0

    def _connection(self) -> None:
        body = message.connection(self._word, self._publish_s, self.twins.heard())
        self.broker.say(self._connection_topic, self._header.message(topics.CONNECTION, body, time.time()), retain=True)

    def _publish(self, found: State | FailstopError, now_s: float) -> None:
        if self.broker.problem:
            return
        body = _body(found, self.own_errors(now_s))
        steady = message.steady(body)
        age_s = now_s - self._published_s
        new = steady != self._shown[0] or (body != self._shown[1] and age_s >= CHANGES_S)
        if new or age_s >= self._publish_s:
            self._shown, self._published_s = (steady, body), now_s
            payload = self._header.message(topics.STATE, body, time.time())
            self.broker.say(self._header.topic(topics.STATE), payload, qos=ANYHOW, retain=True)

    def _publish_event(self, event: Event) -> None:
        body = {"kind": event.kind, "level": event.level, "text": event.text, "event_t": event.t}
        payload = self._header.message(topics.EVENT, {**body, "fields": event.fields}, time.time())
        self.broker.say(self._header.topic(topics.EVENT), payload, qos=ANYHOW, retain=True)

    def own_errors(self, now_s: float) -> tuple[dict[str, Any], ...]:
        """Return the publisher's own errors, such as forged stops. They are published along with the service's
        errors."""
        found = []
        if off := self._off or self._refuses():
            found.append(message.warning(message.FLEET_STOP_OFF, off, "`failstop doctor` on the robot says more"))
        if self.twins.others:
            text = f"another publisher also calls itself {self.robot_id}: set robot.id on one, restart both"
            found.append(message.warning(message.DOUBLED, text, f"robot.id is in {PLACE}"))
        if now_s - self._forged_s < FORGED_S:
            text = f"somebody without the fleet's key sends messages on {self._stop_topic}"
            found.append(message.warning("forged_stop", text, "check the broker's access list: who may write there?"))
        return tuple(found)

    def _hear(self, topic: str, payload: bytes, retained: bool) -> None:
        """Handle a message: either a fleet stop, or a connection message with this robot's name. The fleet stop may be
        forged, and the connection message may come from another publisher."""
        if topic == self._connection_topic:
            self.twins.hear(payload, retained=retained)
            return
        if self._off:
            return
        now_s, unix_s = time.monotonic(), time.time()
        order, answer = self.duties.hear(payload, now_s, unix_s)
        if order:
            state = _state(self._robot.read())
            if not self.busy(now_s):
                self._built_s = now_s
            if problem := self._ask(order, state, self._robot.run, now_s, unix_s):
                answer = self.duties.failed(order, problem)
            else:
                self._look_at_s = now_s + FIRST_LOOK_S
            _log(order, problem or "asked for")
        if answer:
            self._answer(answer)
        self._note_forged(now_s)

    def _ask(self, order: Order, state: State | None, run: str, now_s: float, unix_s: float) -> str:
        """Request a stop from the service. Returns an error text, or "". `state`, `run`: as the last read() found
        them."""
        if problem := self._robot.stop(order.reason, order.by):
            return problem
        self.duties.begin(order, now_s, unix_s, state, run)
        self.unsaved = True
        return ""

    def _note_forged(self, now_s: float) -> None:
        if self.duties.forged > self._said_forged:
            if now_s - self._forged_s > FORGED_S:
                standard.say(f"ignored a message on {self._stop_topic}: {self.duties.last_forged}")
            self._said_forged, self._forged_s = self.duties.forged, now_s

    def _answer(self, answer: StopAnswer) -> None:
        topic = topics.answer(self._fleet, answer.id, self.robot_id)
        whole = dataclasses.replace(
            answer,
            publisher=self.number,
            doubled=bool(self.twins.others),
            connected_s=round(self.broker.connected_s(), 3),
        )
        self.broker.say(topic, whole.message(self._key), qos=ANYHOW)  # if this answer is lost, the sender asks again

    def _remember(self) -> None:
        """Save the ids of obeyed stops for the next start. An error is only logged, because the robot must keep obeying
        stops."""
        draft = f"{self._store}.new"
        try:
            durable.write_draft(draft, self._seen.dump())
            durable.publish(draft, self._store)
        except OSError as error:
            standard.say(
                f"{self._store} can't be written ({error.strerror}), so a restart forgets which stops were obeyed"
            )


def _log(order: Order, outcome: str) -> None:
    standard.say(f"fleet stop by {order.by}: {order.reason or 'no reason given'}: {outcome}")


def _key(settings: FleetSettings) -> tuple[bytes, str]:
    """Return (the fleet's key, ""), or (b"", the reason why there is no key)."""
    try:
        return signed.read_key(settings.secret("stop.key_file", KEY)), ""
    except FleetError as error:
        standard.say(f"this robot obeys no fleet stop: {error}")
        return b"", str(error)


def _remembered(path: str, tolerance_s: float) -> Seen:
    """Read which stops were obeyed earlier. If the file is missing or can't be read, a recorded stop can work again
    while its date is within the tolerance."""
    try:
        fd = durable.open_own(path)
        with contextlib.closing(os.fdopen(fd, "rb")) as file:
            return Seen.load(file.read(), tolerance_s)
    except FileNotFoundError:
        return Seen(tolerance_s)
    except (OSError, ValueError) as error:
        standard.say(f"{path} can't be read ({error}), so it is not known which stops were obeyed before")
        return Seen(tolerance_s)


def store(name: str) -> str:
    """Return the folder of the file with the obeyed stops, and make it if it does not exist. Raises FleetError."""
    path = state_directory(name, os.environ)
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise FleetError(f"{path} can't be made: {error.strerror}") from None
    return path

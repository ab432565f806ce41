"""Commanders: which nodes publish cmd_vel, and whether a command may be passed on. Pure: the graph and the time are
arguments.

The graph is DDS's list of publishers. It has every publisher of a topic, whatever its type and quality, and a killed
publisher for up to 20 s. It is read before every command. Otherwise commands of a second publisher would pass between
two looks (36 of 48 tries with a look every 20 ms, measured). It is also read 50 times a second, to notice publishers
that are silent.

On an overloaded machine a command may wait in a queue for 0.1 to 0.7 s. Its publisher may be gone by the time the
bridge handles it (66 of 400 tries, measured). So a command is judged by who published when it was received.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from failstop.api.state import State
from failstop.policy import causes
from failstop.policy.causes import NOT_KNOWN, Kind

FRESH_NS = 100_000_000
"""How long a look at the graph, or a message of a sensor, stays valid."""
GONE_NS = 300_000_000
"""How long after a publisher has gone its commands may still arrive, because DDS's threads may also be late."""
AGAIN_NS = 500_000_000
"""How often to look who publishes even if the number of publishers stays the same, because one may have replaced
another."""
NAMELESS_NS = 2_000_000_000
"""How long to wait for the node name of a publisher, which may become known later than the publisher. After that, the
publisher counts as one without a name."""
STOP_AGAIN_NS = 500_000_000
"""After this time a requested stop that is still not latched is requested again."""
WINDOW_NS = 5_000_000_000
STEADY_GAP_NS = 500_000_000
"""The longest pause between the messages of a steady window. A link that comes and goes leaves longer ones."""
NAMELESS = f"a node whose name is {NOT_KNOWN}"
DEAD_ONE = "one of them may be a dead process, which DDS counts for up to 20 s"
LONGEST_NAMES = 150


class Publisher(NamedTuple):
    """One publisher in the graph. `node` is /namespace/name, or empty if the name is not known yet."""

    node: str
    type: str
    reliable: bool = True
    lasting: bool = False
    """True if its durability is transient local."""


def waited_ns(received_ns: int, wall_ns: int) -> int:
    """How long a message has waited in its queue, ns. `received_ns`: when DDS received it, or 0 if not known.
    `wall_ns`: now. Both are wall clock times. The result is FRESH_NS if it can't be known, for example after the clock
    was set back."""
    return wall_ns - received_ns if 0 < received_ns <= wall_ns else FRESH_NS


class Lag:
    """Measures how much later than usual a message arrived. DDS may send a lost message again seconds later, and shows
    it as just received. Only the sender's time shows the delay, but the sender's clock may differ from this computer's.
    So the delay of the sender's quickest recent message serves as the zero point."""

    def __init__(self) -> None:
        self._of: Sequence[Publisher] = ()
        self._begun_ns = self._before_ns = self._least_ns = self._last_ns = self._gap_ns = 0
        """When the present window began, the zero point from before it, the smallest lag of the present window, when
        its last message was received, and the longest pause between its messages, ns."""

    def late_ns(self, publishers: Sequence[Publisher], sent_ns: int, received_ns: int) -> int:
        """How much later than usual a message of these publishers arrived, ns. `sent_ns`: the sender's wall clock, or 0
        if not known. `received_ns`: this computer's wall clock. Returns 0 for the first message, and if `sent_ns` is 0.
        The zero point is kept however long the publishers are quiet. After a clock was set, or after clocks drifted
        apart meanwhile, messages may count as late until one window had messages over at least half of it, without a
        pause of over STEADY_GAP_NS."""
        if not sent_ns:
            return 0
        lag_ns, age_ns = received_ns - sent_ns, received_ns - self._begun_ns
        if publishers != self._of or age_ns < 0:
            self._of, self._begun_ns, self._before_ns, self._least_ns = publishers, received_ns, lag_ns, lag_ns
            self._gap_ns = 0
        elif age_ns >= WINDOW_NS:
            # Messages that arrived only in bursts may all have been resent. They say nothing about the clocks, so they
            # can't raise the zero point.
            steady = self._last_ns - self._begun_ns >= WINDOW_NS // 2 and self._gap_ns <= STEADY_GAP_NS
            self._before_ns = self._least_ns if steady else min(self._before_ns, self._least_ns)
            self._begun_ns, self._least_ns, self._gap_ns = received_ns, lag_ns, 0
        else:
            self._gap_ns = max(self._gap_ns, received_ns - self._last_ns)
        self._last_ns = received_ns
        self._least_ns = min(self._least_ns, lag_ns)
        return lag_ns - min(self._before_ns, self._least_ns)


class Asking:
    """Decides when to request a stop: at once, and again while it is not latched. If the cause lacked the names of
    nodes, the stop is requested once more with the names, which completes the cause."""

    def __init__(self) -> None:
        self._asked_ns = 0
        self._cause = ""

    def due(self, cause: str, latched: bool, now_ns: int) -> bool:
        """True if a stop with this cause must be requested now. `cause`: why, or "" if there is no reason for a stop.
        `latched`: True if a stop is latched."""
        if not cause:
            self._asked_ns, self._cause = 0, ""
            return False
        completed = NOT_KNOWN in self._cause and NOT_KNOWN not in cause
        if self._asked_ns and not completed and (latched or now_ns - self._asked_ns < STOP_AGAIN_NS):
            return False
        self._asked_ns, self._cause = now_ns, cause
        return True


class Owed:
    """Decides whether one stop must be requested again. That a request was written is no proof, because a service that
    is ending may never read it, and the next run begins without a latched stop."""

    def __init__(self) -> None:
        self._asked_ns: int | None = None
        """When the stop was requested last. None if no stop is owed."""
        self._sent = False
        self._run, self._epoch = "", 0

    def asked(self, state: State | None, now_ns: int, *, sent: bool) -> None:
        """Note that the stop was requested. `state`: the last state before the request. `sent`: False if there was no
        service to stop."""
        self._asked_ns, self._sent = now_ns, sent
        self._run, self._epoch = (state.run, state.epoch) if state else ("", 0)

    def due(self, state: State | None, now_ns: int) -> bool:
        """True if the stop must be requested again now. `state`: the present state."""
        if self._asked_ns is None or state is None:
            return False
        # In the same run, a stop may be latched already, and a person may have reset it again, so only the epoch tells.
        heard = state.epoch > self._epoch if state.run == self._run else state.estop is not None
        if self._sent and heard:
            self._asked_ns = None
            return False
        return now_ns - self._asked_ns >= STOP_AGAIN_NS


class Reason(str):
    """Why the bridge requests a stop, in words. `row` is the kind of the cause, and `given` is the text that is sent
    with the request."""

    __slots__ = ("given", "row")
    row: Kind
    given: str


def reason(row: Kind, given: str, more: str = "") -> Reason:
    """Make a Reason. `more`: a remark for the log, and for callers whose request is refused."""
    made = Reason(causes.bare(row(given, "", 0)) + more)
    made.row, made.given = row, given
    return made


def rivals(row: Kind, publishers: Sequence[Publisher]) -> Reason:
    """The reason for a stop because a topic has several publishers."""
    return reason(row, names(publishers), f" ({DEAD_ONE})")


def names(publishers: Sequence[Publisher]) -> str:
    """The names of the nodes that publish, in one text."""
    nodes = [publisher.node or NAMELESS for publisher in publishers]
    counts = {node: nodes.count(node) for node in nodes}
    text = ", ".join(f"{node} ({count} times)" if count > 1 else node for node, count in counts.items())
    if len(text) > LONGEST_NAMES:
        text = f"{text[:LONGEST_NAMES].rpartition(',')[0] or text[:LONGEST_NAMES]} and more"
    return text or "nodes that are not known yet"


class Commanders:
    """Who publishes cmd_vel, as last seen."""

    def __init__(self, accepted: Sequence[str], allowed: Sequence[str] = ()) -> None:
        """`accepted`: the message types that are accepted. The first one is used until a publisher offers another.
        `allowed`: the nodes that may publish; empty to allow all nodes."""
        self._accepted = tuple(accepted)
        self._allowed = frozenset(name for name in allowed if name)
        self.publishers: tuple[Publisher, ...] = ()
        self.count = 0
        self._counted_ns = 0
        self._good_ns: int | None = None
        """Since this time every look has found at most one publisher, which must be an allowed one. None if the last
        look found something else."""
        self._looked_ns = 0
        self._nameless_ns: int | None = None
        self._asking = Asking()

    def wants_look(self, count: int, now_ns: int) -> bool:
        """True if the publishers must be looked up now. `count`: how many there are."""
        stale = now_ns - self._looked_ns >= AGAIN_NS
        return count != self.count or stale or bool(count and (self._allowed or self._nameless()))

    def look(self, publishers: Sequence[Publisher], now_ns: int) -> None:
        """Note the publishers that were found."""
        self.publishers = tuple(publishers)
        self._looked_ns = now_ns
        self._nameless_ns = (self._nameless_ns or now_ns) if self._nameless() else None

    def counted(self, count: int, now_ns: int) -> None:
        """Note how many publishers the graph has just shown. If wants_look() is True, call look() before."""
        if count > 1 or (self._allowed and not all(self._allows(publisher.node) for publisher in self.publishers)):
            self._good_ns = None
        elif self._good_ns is None:
            self._good_ns = now_ns + GONE_NS
        elif now_ns - self._counted_ns > FRESH_NS:
            self._good_ns = max(self._good_ns, now_ns + FRESH_NS)
        self.count = count
        self._counted_ns = now_ns

    def _nameless(self) -> bool:
        return any(not publisher.node for publisher in self.publishers)

    def cause(self, now_ns: int) -> str:
        """Why a stop must be latched now. Empty if there is no reason."""
        if self.count > 1:
            return rivals(causes.ROS_PUBLISHERS, self.publishers)
        if strangers := self._strangers(now_ns):
            allowed = ", ".join(sorted(self._allowed))
            return reason(causes.ROS_STRANGER, f"{', '.join(strangers)} (allowed: {allowed})")
        return ""

    def due(self, cause: str, latched: bool, now_ns: int) -> bool:
        """True if a stop with this cause must be requested now. It is decided by Asking.due()."""
        return self._asking.due(cause, latched, now_ns)

    def _strangers(self, now_ns: int) -> list[str]:
        if not self._allowed:
            return []
        waited = self._nameless_ns is not None and now_ns - self._nameless_ns >= NAMELESS_NS
        names = [publisher.node or NAMELESS for publisher in self.publishers if publisher.node or waited]
        return [name for name in names if not self._allows(name)]

    def _allows(self, node: str) -> bool:
        return node in self._allowed or node.rpartition("/")[2] in self._allowed

    def passes(self, received_ns: int) -> bool:
        """True if a command that DDS received at `received_ns` (CLOCK_MONOTONIC) may be passed on. Since before that
        time, every look at the graph must have shown at most one publisher, which must be an allowed one. Otherwise the
        command may come from a node that has left. Read the graph before you call this."""
        return self._good_ns is not None and self._good_ns < received_ns

    def holds(self, now_ns: int) -> bool:
        """True if the bridge's interlock may be asserted: a recent look at the graph found at most one publisher, which
        must be an allowed one."""
        return now_ns - self._counted_ns <= FRESH_NS and self._good_ns is not None

    def names(self) -> str:
        """The names of the nodes that publish cmd_vel, in one text."""
        return names(self.publishers)

    def wanted_type(self, now: str) -> str:
        """The message type to subscribe to: the accepted type that is offered. If none or several are offered, the
        present type `now`."""
        offered = {publisher.type for publisher in self.publishers} & set(self._accepted)
        return offered.pop() if len(offered) == 1 else now if now in self._accepted else self._accepted[0]

    def wrong(self) -> list[str]:
        """What is wrong with the present publishers, one line for each problem."""
        return wrong_ends("cmd_vel", self.publishers, self._accepted, reliable=True)


def wrong_ends(topic: str, publishers: Sequence[Publisher], accepted: Sequence[str], *, reliable: bool) -> list[str]:
    """Why publishers of a topic are never heard, one line for each: a wrong type, or best effort although `reliable` is
    needed."""
    found = []
    for node, kind, is_reliable, _ in publishers:
        who = node or NAMELESS
        if kind not in accepted:
            found.append(f"{who} publishes {short(kind)} on {topic}, which is {' or '.join(map(short, accepted))}")
        elif reliable and not is_reliable:
            found.append(f"{who} publishes {topic} as best effort, which is not heard: make it reliable")
    return found


def short(kind: str) -> str:
    """The short name of a type. For example, geometry_msgs/msg/Twist becomes Twist."""
    return kind.rpartition("/")[2]

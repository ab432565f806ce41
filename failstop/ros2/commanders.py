"""Commanders: who publishes cmd_vel, and whether a command may be passed on. Pure: graph and time are arguments.

The graph is what DDS knows: a publisher of any type and any quality counts in it, matched or not; one that was killed
counts for up to 20 s after its death. It is asked before every command, and 50 times a second for publishers that are
silent: between two looks, commands of a second one would pass (36 of 48 tries at a look each 20 ms, measured). And what
is called back now may have waited: on an overloaded machine, commands were taken 0.1 to 0.7 s after they came, when who
had sent them was gone (66 of 400 tries, measured). So what counts is who published when a command was received.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from failstop.policy import causes
from failstop.policy.causes import NOT_KNOWN, Kind

FRESH_NS = 100_000_000
"""How long a look at the graph, or a sensor's word, is good for."""
GONE_NS = 300_000_000
"""The commands of one that has gone are received by then: DDS's own threads may be late too."""
AGAIN_NS = 500_000_000
"""The time between two looks at the publishers, even if their number stays: one may have taken another's place."""
NAMELESS_NS = 2_000_000_000
"""A publisher's node name may come later than the publisher; longer than this, it counts as having none."""
STOP_AGAIN_NS = 500_000_000
"""A stop that was asked for and is not latched is asked for again."""
WINDOW_NS = 5_000_000_000
NAMELESS = f"a node whose name is {NOT_KNOWN}"
DEAD_ONE = "one of them may be a dead process, which DDS counts for up to 20 s"
LONGEST_NAMES = 150


class Publisher(NamedTuple):
    """One publisher in the graph. `node`: /namespace/name; empty: not known yet."""

    node: str
    type: str
    reliable: bool = True


def waited_ns(received_ns: int, wall_ns: int) -> int:
    """How long a message waited in its queue. `received_ns`: when DDS had it, `wall_ns`: now, both of the wall clock.
    Where DDS does not say (0), or the clock was set back meanwhile, it is FRESH_NS."""
    return wall_ns - received_ns if 0 < received_ns <= wall_ns else FRESH_NS


class Lag:
    """How much later than its quickest one a message came, by the clock of who sent it, which need not agree with
    this one. DDS sends again what was lost, seconds later, and that counts as just received then."""

    def __init__(self) -> None:
        self._of: Sequence[Publisher] = ()
        self._begun_ns = self._before_ns = self._least_ns = 0
        """When this window began; the quickest of the one before it, and of this one."""

    def late_ns(self, publishers: Sequence[Publisher], sent_ns: int, received_ns: int) -> int:
        """How much later than usual a message of these publishers came, ns. Each of the two times is of its own
        computer's wall clock. 0 for the first message, and if DDS does not say when it was sent (`sent_ns` is 0). If a
        clock steps, messages count as late for two windows at most."""
        if not sent_ns:
            return 0
        lag_ns, age_ns = received_ns - sent_ns, received_ns - self._begun_ns
        same = publishers == self._of and 0 <= age_ns < 2 * WINDOW_NS
        if not same or age_ns >= WINDOW_NS:
            self._before_ns = self._least_ns if same else lag_ns
            self._of, self._begun_ns, self._least_ns = publishers, received_ns, lag_ns
        self._least_ns = min(self._least_ns, lag_ns)
        return lag_ns - min(self._before_ns, self._least_ns)


class Asking:
    """When a stop is asked for: at once, again while it is not latched, and once more when the names are known that its
    cause lacked, which completes the cause."""

    def __init__(self) -> None:
        self._asked_ns = 0
        self._cause = ""

    def due(self, cause: str, latched: bool, now_ns: int) -> bool:
        """True when a stop with that cause is to be asked for now; empty: there is no reason for one."""
        if not cause:
            self._asked_ns, self._cause = 0, ""
            return False
        completed = NOT_KNOWN in self._cause and NOT_KNOWN not in cause
        if self._asked_ns and not completed and (latched or now_ns - self._asked_ns < STOP_AGAIN_NS):
            return False
        self._asked_ns, self._cause = now_ns, cause
        return True


class Reason(str):
    """Why the bridge asks for a stop, in words. `row`: the cause; `given`: its own words, which are sent."""

    __slots__ = ("given", "row")
    row: Kind
    given: str


def reason(row: Kind, given: str, more: str = "") -> Reason:
    """A reason; `more`: a remark for the log and for who is refused."""
    made = Reason(causes.bare(row(given, "", 0)) + more)
    made.row, made.given = row, given
    return made


def rivals(row: Kind, publishers: Sequence[Publisher]) -> Reason:
    """The reason of a stop for several publishers of a topic."""
    return reason(row, names(publishers), f" ({DEAD_ONE})")


def names(publishers: Sequence[Publisher]) -> str:
    """The nodes that publish."""
    nodes = [publisher.node or NAMELESS for publisher in publishers]
    counts = {node: nodes.count(node) for node in nodes}
    text = ", ".join(f"{node} ({count} times)" if count > 1 else node for node, count in counts.items())
    if len(text) > LONGEST_NAMES:
        text = f"{text[:LONGEST_NAMES].rpartition(',')[0] or text[:LONGEST_NAMES]} and more"
    return text or "nodes that are not known yet"


class Commanders:
    """The publishers of cmd_vel as last seen."""

    def __init__(self, accepted: Sequence[str], allowed: Sequence[str] = ()) -> None:
        """`accepted`: types that are taken, the first while nobody publishes; `allowed`: nodes, none: any."""
        self._accepted = tuple(accepted)
        self._allowed = frozenset(name for name in allowed if name)
        self.publishers: tuple[Publisher, ...] = ()
        self.count = 0
        self._counted_ns = 0
        self._good_ns: int | None = None
        """Since then every look has found one publisher at most, and no stranger; None: the last one did not."""
        self._looked_ns = 0
        self._nameless_ns: int | None = None
        self._asking = Asking()

    def wants_look(self, count: int, now_ns: int) -> bool:
        """Whether who publishes is to be looked up now, the number being `count`."""
        stale = now_ns - self._looked_ns >= AGAIN_NS
        return count != self.count or stale or bool(count and (self._allowed or self._nameless()))

    def look(self, publishers: Sequence[Publisher], now_ns: int) -> None:
        """Take the publishers."""
        self.publishers = tuple(publishers)
        self._looked_ns = now_ns
        self._nameless_ns = (self._nameless_ns or now_ns) if self._nameless() else None

    def counted(self, count: int, now_ns: int) -> None:
        """How many publish, by the graph, a moment ago; who they are was looked up, if that was wanted."""
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
        """Why a stop is to be latched now; empty: there is no reason."""
        if self.count > 1:
            return rivals(causes.ROS_PUBLISHERS, self.publishers)
        if strangers := self._strangers(now_ns):
            allowed = ", ".join(sorted(self._allowed))
            return reason(causes.ROS_STRANGER, f"{', '.join(strangers)} (allowed: {allowed})")
        return ""

    def due(self, cause: str, latched: bool, now_ns: int) -> bool:
        """As Asking.due()."""
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
        """Whether a command that DDS received then (CLOCK_MONOTONIC ns) may be passed on, the graph having been asked
        since: there was one publisher at most, and no stranger, from before it came until now. One that waited in a
        queue may be of somebody who has left meanwhile."""
        return self._good_ns is not None and self._good_ns < received_ns

    def holds(self, now_ns: int) -> bool:
        """Whether the bridge's interlock holds: the graph was asked lately, and one at most commands."""
        return now_ns - self._counted_ns <= FRESH_NS and self._good_ns is not None

    def names(self) -> str:
        """The nodes that publish."""
        return names(self.publishers)

    def wanted_type(self, now: str) -> str:
        """The type to subscribe to: the one offered, if it is taken; with nobody there, or with both, what it is
        now."""
        offered = {publisher.type for publisher in self.publishers} & set(self._accepted)
        return offered.pop() if len(offered) == 1 else now if now in self._accepted else self._accepted[0]

    def wrong(self) -> list[str]:
        """Faults of the publishers that there are, a line each."""
        return wrong_ends("cmd_vel", self.publishers, self._accepted, reliable=True)


def wrong_ends(topic: str, publishers: Sequence[Publisher], accepted: Sequence[str], *, reliable: bool) -> list[str]:
    """Publishers of a topic that are never heard: of another type, or best effort where reliable is asked for."""
    found = []
    for node, kind, is_reliable in publishers:
        who = node or NAMELESS
        if kind not in accepted:
            found.append(f"{who} publishes {short(kind)} on {topic}, which is {' or '.join(map(short, accepted))}")
        elif reliable and not is_reliable:
            found.append(f"{who} publishes {topic} as best effort, which is not heard: make it reliable")
    return found


def short(kind: str) -> str:
    """A type as people call it: geometry_msgs/msg/Twist is Twist."""
    return kind.rpartition("/")[2]

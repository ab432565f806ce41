"""Events: what the supervisor tells people - in the journal or on stderr, and in a ring for programs.

Told is not yet sent: events wait for flush(), which comes at the end of a turn, when the bytes of a stop are out.
"""

from __future__ import annotations

import os
import select

from failstop.policy import causes
from failstop.shm import instance, layout
from failstop.shm.packing import fitting
from failstop.supervisor.allowance import ASKED_BYTES, OWN_BYTES, Allowance
from failstop.supervisor.fold import PREFIX, fitted
from failstop.supervisor.journal import encode
from failstop.supervisor.kinds import BY_NAME, LEVELS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.procs.world import World
    from failstop.shm.cell import RingWriter
    from failstop.supervisor.datagram import Outbox
    from failstop.supervisor.journal import Value

    Told = tuple[int, float, str, str, str, dict[str, Value]]
    Sort = tuple[str, str, bool]

LONGEST_HOLD_NS = 50_000_000
"""Events wait at most this long for a stop's bytes, which are out within 5 ms where they can be written at all."""
MOST_WAITING = 256
CUTS = ((280, 280), (200, 60), (120, 24))
"""As packing.CUTS."""
ASKED = frozenset((causes.REQUESTED.name, causes.PIPED.name, causes.FLEET.name))
AGAIN = frozenset(("stop_again", "stop_also"))
"""What anybody can bring about without end; a stop that is latched again takes somebody who resets."""
ROOM = layout.BY_NAME[layout.SUPERVISOR].records["events"].capacity


def say(text: str) -> None:
    """Write one line to stderr, broken at words on a terminal. A log that can't be written is no reason to stop
    working, nor one that nobody reads (a full pipe, a terminal held by Ctrl-S): the line is dropped then."""
    try:
        if select.select((), (2,), (), 0)[1]:
            os.write(2, f"{fitted(PREFIX + text, 2)}\n".encode("utf-8", "replace"))
    except OSError:
        return


class Events:
    """The one place where events leave the service. Without a journal they are lines on stderr."""

    def __init__(
        self,
        world: World,
        name: str,
        ring: RingWriter | None = None,
        journal: Outbox | None = None,
        published: int = -1,
    ) -> None:
        """`name`: the instance's; `published`: the descriptor of its run's file, by which whoever waits is woken."""
        self._now_ns, self._unix_s = world.now_ns, world.unix_s
        self._name = name
        self._ring = ring
        self._journal = journal
        self._published = published
        self._waiting: list[Told] = []
        self._allowances: dict[Sort, Allowance] = {}
        self._short: set[Sort] = set()
        """Sorts of which events were left out, and that was not told yet."""

    def tell(self, kind: str, text: str, fields: Mapping[str, Value | None] | None = None, *, level: str = "") -> None:
        """An event of a kind of kinds.py (any other becomes a note), at its kind's level or another; a field that is
        None is left out."""
        known = BY_NAME.get(kind) or BY_NAME["note"]
        given = {key: value for key, value in (fields or {}).items() if value is not None}
        now_ns, level = self._now_ns(), level if level in LEVELS else known.level
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append((now_ns, self._unix_s(), known.name, level, text, given))
        else:
            sort = known.name, level, _asked(known.name, given)
            self._allowance(sort, now_ns).left_out += 1
            self._short.add(sort)

    def command(self, words: str) -> str:
        """A command to type next, in backquotes, for this instance."""
        return f"`failstop {words}{instance.option(self._name)}`"

    def flush(self, now_ns: int = 0, *, hold: bool = False) -> None:
        """Send what was told. `hold`: a stop's bytes are not out yet; then only what has waited for long. `now_ns` 0:
        the end, and what was left out is told of now."""
        if self._waiting and not (hold and now_ns - self._waiting[0][0] < LONGEST_HOLD_NS):
            self._send_waiting()
        for sort in tuple(self._short):
            if not now_ns or self._allowances[sort].reopens(self._now_ns()):
                self._tell_left_out(sort)
        if not now_ns:
            self._send_waiting()

    def _send_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for told in waiting:
            self._send(*told)
        if waiting and self._published >= 0:
            instance.touch(self._published)

    def _send(self, t_ns: int, unix_s: float, kind: str, level: str, text: str, fields: dict[str, Value]) -> None:
        """To everybody, unless there was too much of its sort."""
        datagram = encode(entry(self._name, t_ns, kind, level, text, fields)) if self._journal else b""
        size = len(datagram) or len(f"{PREFIX}{text}\n".encode("utf-8", "replace"))
        sort = kind, level, _asked(kind, fields)
        if not self._allowance(sort, t_ns).spend(size, t_ns):
            self._short.add(sort)
            return
        if self._ring:
            self._ring.put(pack(t_ns, unix_s, kind, level, text, fields), t_ns)
        if not self._journal or not self._journal.send(datagram):
            say(text)

    def _allowance(self, sort: Sort, now_ns: int) -> Allowance:
        if sort not in self._allowances:
            self._allowances[sort] = Allowance(ASKED_BYTES if sort[2] else OWN_BYTES, now_ns)
        return self._allowances[sort]

    def _tell_left_out(self, sort: Sort) -> None:
        self._short.discard(sort)
        kind, level, asked = sort
        count = self._allowances[sort].reopen()
        what = "stop requests while a stop was latched" if asked else f"events of the kind {kind}"
        text = f"{count} {what} were left out: too many to tell of each"
        self.tell("left_out", text, {"of": kind, "count": count}, level=level)


def _asked(kind: str, fields: Mapping[str, Value]) -> bool:
    """True for what anybody may bring about without end."""
    return kind in AGAIN and fields.get("cause") in ASKED


def entry(name: str, t_ns: int, kind: str, level: str, text: str, fields: dict[str, Value]) -> list[tuple[str, Value]]:
    """The journal's fields of one event of the instance `name`."""
    return [
        ("MESSAGE", text),
        ("PRIORITY", LEVELS[level]),
        ("MESSAGE_ID", BY_NAME[kind].message_id),
        ("SYSLOG_IDENTIFIER", "failstop"),
        ("FAILSTOP_EVENT", kind),
        ("FAILSTOP_NAME", name),
        ("FAILSTOP_MONOTONIC_NS", t_ns),
        *((f"FAILSTOP_{key.upper()}", value) for key, value in fields.items()),
    ]


def pack(t_ns: int, unix_s: float, kind: str, level: str, text: str, fields: dict[str, Value]) -> bytes:
    """One event for the ring, as a msgpack map."""
    told = {"t": unix_s, "ns": t_ns, "kind": kind, "level": level}
    return fitting(ROOM, CUTS, text, fields, lambda text, fields: {**told, "text": text, "fields": fields})

"""Events: what the supervisor reports to people (in the journal or on stderr) and to programs (in a ring).

Events wait in a queue first, because the bytes of a stop must go out before any text. flush() sends the events at the
end of the turn.
"""

from __future__ import annotations

import os
import select
from collections import Counter
from collections.abc import Iterable, Mapping
from time import monotonic_ns, time

from failstop.files import instance
from failstop.messages import layout
from failstop.messages.packing import NEXT_STEP, Value, fitting
from failstop.notify import Outbox
from failstop.policy import causes
from failstop.policy.setting import UNITS
from failstop.shm.cell import RingWriter
from failstop.supervisor.kinds import EVENT_BY_NAME, LEVELS

EventRow = tuple[int, float, str, str, str, str, dict[str, Value]]
FloodSort = tuple[str, str, bool]
JOURNAL = "/run/systemd/journal/socket"
STDERR = 2
LONGEST_HOLD_NS = 50_000_000
"""The longest time that events wait for a stop to be written. Normally a stop is written within 5 ms. A stop that takes
longer than LONGEST_HOLD_NS probably can't be written at all, and people must learn about it."""
MOST_EVENTS_WAITING = 256
EVENT_CUTS = ((280, 280), (200, 60), (120, 24))
"""Pairs of limits, in bytes: (the longest text of an event, the longest value of a field). The pairs are tried in this
order, until the whole event is short enough."""
EVENT_BYTES = layout.SEGMENT_BY_NAME[layout.SUPERVISOR].records["events"].capacity
ASKED = frozenset(kind.name for kind in (*causes.SIGNED, causes.PIPED, causes.FLEET))
AGAIN = frozenset(("stop_again", "stop_also"))
"""The kinds of events that a user can cause again and again without any rights. The kind "stop" is not in this set:
there is only one such event for each latched stop, and another stop can be latched only after a reset."""
MINUTE_NS = 60_000_000_000
OWN_BYTES = 65536
"""How many bytes the events of one kind and level may take in the log per minute. This is enough for about 130 latched
stops of 500 bytes each."""
REPEATS_BYTES = 8192
"""How many bytes per minute the log may take for requests to stop a robot that is already stopped. Any user can send
such requests without end, and they change nothing."""
LEAST_COLUMNS = 40
"""Text is not folded if the terminal has fewer columns than this, because the indent would leave too little room."""
PREFIX = "failstop: "
"""The first word of the service's log lines and of the commands' error messages."""
JOINED = "\0"
"""This character replaces a space at which a line must not be broken."""
AFTER_UNIT = ".,;:!?)]'\""
"""Punctuation marks that may directly follow the unit of a number."""


def fold(text: str, width: int, indent: int) -> str:
    """Break the text into lines of at most `width` columns, and indent all lines except the first one by `indent`
    columns. A command in backquotes, or a number with its unit, stays on one line if it fits. A word that is longer
    than a line is not broken."""
    if len(text) <= width or width < LEAST_COLUMNS:
        return text
    rows, row = [], ""
    words = _words(text.lstrip(" "), width - indent)
    lead = text[: len(text) - len(text.lstrip(" "))]
    if len(lead) <= indent:
        words[0] = lead + words[0]
    for word in words:
        if row and len(row) + 1 + len(word) > width:
            rows.append(row)
            row = " " * indent + word
        else:
            row = f"{row} {word}" if row else word
    return "\n".join([*rows, row])


def _words(text: str, room: int) -> list[str]:
    """The pieces of the text that must not be broken: words, numbers with their units, and commands in backquotes with
    the punctuation next to them. A piece longer than `room` columns is split at its spaces."""
    parts = text.split("`")
    parts[1:-1:2] = [command.replace(" ", JOINED) for command in parts[1:-1:2]]
    whole: list[str] = []
    for word in "`".join(parts).split(" "):
        if whole and whole[-1][-1:].isdecimal() and word.rstrip(AFTER_UNIT) in UNITS:
            whole[-1] += JOINED + word
        else:
            whole.append(word)
    found: list[str] = []
    for word in whole:
        found += [word.replace(JOINED, " ")] if len(word) <= room else word.split(JOINED)
    return found


def fitted(text: str, fd: int, indent: int = len(PREFIX)) -> str:
    """The text, ready to be written to the descriptor `fd`. It is folded if `fd` is a terminal."""
    try:
        return fold(text, os.get_terminal_size(fd).columns, indent)
    except (OSError, ValueError):
        return text


def without_waiting() -> int:
    """Return a descriptor of stderr for say(). A terminal accepts a part of a message and then waits for room, even if
    it reported room before. So a terminal is opened once more, because the shell has stderr itself too, which must not
    become non-blocking."""
    try:
        if os.isatty(STDERR):
            return os.open(os.ttyname(STDERR), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except OSError:
        pass
    return STDERR


def say(text: str, fd: int = STDERR) -> None:
    """Write one message to stderr, folded if stderr is a terminal. The service must never wait for its log, so the
    message is dropped if it can't be written at once, for example because the terminal is paused by Ctrl-S. `fd`: from
    without_waiting()."""
    try:
        if select.select((), (fd,), (), 0)[1]:
            os.write(fd, f"{fitted(PREFIX + text, fd)}\n".encode("utf-8", "replace"))
    except OSError:
        return


class Events:
    """Sends the service's events to the ring and to the journal, or to stderr if the journal does not accept them. No
    other part of the service sends events."""

    def __init__(self, name: str, ring: RingWriter | None = None, journal: Outbox | None = None) -> None:
        """`name`: the name of the instance."""
        self._name = name
        self._ring = ring
        self._journal = journal
        self._stderr = without_waiting()
        self._waiting: list[EventRow] = []
        self._minute_ns = 0
        """When the current minute began. In each minute, the events of one sort may take only a limited number of bytes
        in the log."""
        self._spent: Counter[FloodSort] = Counter()
        """How many bytes the events of each sort have taken in the log in the current minute. A sort is (kind, level,
        True if any user can cause the event again and again)."""
        self._left_out: Counter[FloodSort] = Counter()
        """How many events of each sort were dropped since dropped events were last reported."""

    def log(
        self, kind: str, text: str, fields: Mapping[str, Value | None] | None = None, *, level: str = "", step: str = ""
    ) -> None:
        """Queue an event. `kind`: a kind from kinds.py; an unknown kind becomes a note. `level`: if given, the event
        has this level instead of the usual level of its kind. `step`: what the reader can do next. A field whose value
        is None is left out."""
        known = EVENT_BY_NAME.get(kind) or EVENT_BY_NAME["note"]
        given = {key: value for key, value in (fields or {}).items() if value is not None}
        now_ns, level = monotonic_ns(), level if level in LEVELS else known.level
        if len(self._waiting) < MOST_EVENTS_WAITING:
            self._waiting.append((now_ns, time(), known.name, level, text, step, given))
        else:
            self._left_out[known.name, level, _asked(known.name, given)] += 1

    def command(self, words: str) -> str:
        """A command that the reader can type next, in backquotes, with the option for this instance."""
        return f"`failstop {words}{instance.option(self._name)}`"

    def flush(self, now_ns: int = 0, *, hold: bool = False) -> None:
        """Send the queued events. `hold`: True while the bytes of a stop are not written yet. The events then wait for
        up to LONGEST_HOLD_NS. `now_ns`: the time now; 0 at the end of the service.

        The number of dropped events is logged when the minute is over, or at the end of the service.
        """
        over = bool(self._left_out) and now_ns - self._minute_ns >= MINUTE_NS
        if self._waiting and not (hold and now_ns - self._waiting[0][0] < LONGEST_HOLD_NS):
            self._send_waiting()
        if (over and not self._waiting) or not now_ns:
            self._log_left_out()
        if not now_ns:
            self._send_waiting()

    def _send_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            self._send(*event)

    def _send(
        self, t_ns: int, unix_s: float, kind: str, level: str, what: str, step: str, fields: dict[str, Value]
    ) -> None:
        """Send one event to the ring and the journal. The event is dropped if events of its sort have already taken all
        their bytes for this minute."""
        text = f"{what}{NEXT_STEP}{step}" if step else what
        datagram = journal_entry(self._name, t_ns, kind, level, text, fields) if self._journal else b""
        size = len(datagram) or len(f"{PREFIX}{text}\n".encode("utf-8", "replace"))
        sort = kind, level, _asked(kind, fields)
        if not self._may_spend(sort, size, t_ns):
            self._left_out[sort] += 1
            return
        if self._ring:
            self._ring.put(ring_entry(t_ns, unix_s, kind, level, text, fields, len(what) if step else 0), t_ns)
        if not self._journal or not self._journal.send(datagram):
            say(text, self._stderr)

    def _may_spend(self, sort: FloodSort, size: int, t_ns: int) -> bool:
        """Count `size` bytes for this sort of event. Returns False if the sort has used up its bytes for this minute.
        The caller must then drop the event, so that a flood of events becomes a few lines and a count in the log."""
        if t_ns - self._minute_ns >= MINUTE_NS:
            self._minute_ns, self._spent = t_ns, Counter()
        self._spent[sort] += size
        return self._spent[sort] <= (REPEATS_BYTES if sort[2] else OWN_BYTES)

    def _log_left_out(self) -> None:
        left_out, self._left_out = self._left_out, Counter()
        for (kind, level, asked), count in left_out.items():
            what = "stop requests while a stop was latched" if asked else f"events of the kind {kind}"
            text = f"{count} {what} were left out: too many to log each one"
            self.log("left_out", text, {"of": kind, "count": count}, level=level)


def _asked(kind: str, fields: Mapping[str, Value]) -> bool:
    """True if any user could flood the log with events like this one."""
    return kind in AGAIN and fields.get("cause") in ASKED


def ring_entry(
    t_ns: int, unix_s: float, kind: str, level: str, text: str, fields: dict[str, Value], what: int = 0
) -> bytes:
    """One event for the ring, as a msgpack map. `what`: how many characters of the text come before the next step, or 0
    if the text has no next step."""
    told = {"t": unix_s, "ns": t_ns, "kind": kind, "level": level} | ({"what": what} if what else {})
    return fitting(EVENT_BYTES, EVENT_CUTS, text, fields, lambda text, fields: {**told, "text": text, "fields": fields})


def journal_entry(name: str, t_ns: int, kind: str, level: str, text: str, fields: dict[str, Value]) -> bytes:
    """One event of the instance `name` as a datagram for systemd's journal, in the journal's native protocol."""
    told: dict[str, Value] = {
        "MESSAGE": text,
        "PRIORITY": LEVELS[level],
        "MESSAGE_ID": EVENT_BY_NAME[kind].message_id,
        "SYSLOG_IDENTIFIER": "failstop",
        "FAILSTOP_EVENT": kind,
        "FAILSTOP_NAME": name,
        "FAILSTOP_MONOTONIC_NS": t_ns,
    }
    return encode((*told.items(), *((f"FAILSTOP_{key.upper()}", value) for key, value in fields.items())))


def encode(fields: Iterable[tuple[str, Value]]) -> bytes:
    """Encode the fields as a datagram for the journal. A field is usually NAME=VALUE and a line break. A value with a
    line break is sent as the name, a line break, the value's length as a little-endian u64, the value, and a line
    break."""
    parts = []
    for name, value in fields:
        data = str(value).encode("utf-8", "replace")
        if b"\n" in data:
            parts.append(b"%s\n%s%s\n" % (name.encode("ascii"), len(data).to_bytes(8, "little"), data))
        else:
            parts.append(b"%s=%s\n" % (name.encode("ascii"), data))
    return b"".join(parts)


def is_journal(stream: str) -> bool:
    """True if this process's stderr is still the one that systemd has connected to the journal. `stream`: the value of
    $JOURNAL_STREAM, which names the device and inode of that stderr as DEVICE:INODE."""
    try:
        found = os.fstat(STDERR)
    except OSError:
        return False
    return stream == f"{found.st_dev}:{found.st_ino}"

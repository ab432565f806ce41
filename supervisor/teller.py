"""Teller: in which words people are told of stops and of what the processes have to say. It decides nothing."""

from __future__ import annotations

from failstop.policy.causes import Cause
from failstop.shm import heartbeat, layout
from failstop.shm.notes import Note
from failstop.shm.segment import Segment
from failstop.supervisor.events import Events
from failstop.supervisor.stops import NOT_SENT, UNPROVEN, Stop

MOST_SAID = 64
WAITED_NS = 2_000_000_000
"""What motion waits for is told of after this long: a restart takes a fraction of it."""
NO_REALTIME = "no real-time rights (SCHED_FIFO): on a busy machine stops come later, and some for no cause"
NO_EARLY_NEWS = (
    "this kernel tells of a death only once the memory is taken down (no robust futexes): a stop after one comes "
    "later, 1 ms for each 10 MB; run the service on the host's own kernel"
)


class Teller:
    """What was told since the latch, and the remarks of the processes."""

    def __init__(self, name: str, events: Events, views: dict[str, Segment], advice: str) -> None:
        """`advice`: what to do about missing rights."""
        self._name = name
        self._advice = advice
        self.events = events
        self._notes = [(process, views[process].ring_reader("notes")) for process in (layout.GATE, layout.TELEMETRY)]
        self._said: set[Cause] = set()
        """Those that were told of since the latch."""
        self._missing = ""
        self._missing_ns = 0
        self._told_missing = ""

    def latched(self, stop: Stop) -> None:
        """A cause is the first since a reset: everything that follows may be news again."""
        self._said = {stop.cause}

    def _news_of(self, cause: Cause) -> bool:
        """True when this cause was not told of since the latch; several processes notice the same. Of more causes
        than are remembered the older may be told of again."""
        if cause in self._said:
            return False
        if len(self._said) >= MOST_SAID:
            self._said.clear()
        self._said.add(cause)
        return True

    def also(self, stop: Stop) -> None:
        """A cause that came together with others, or before their stop was answered."""
        if self._news_of(stop.cause):
            fields = {**stop.cause.fields(), "noticed_by": stop.noticed_by}
            self.events.tell("stop_also", f"also: {stop.cause}", fields)

    def stopped(self, stop: Stop, *, ending: bool, held: bool = False) -> None:
        """A stop was answered. `held`: the kernel has its bytes, and the board takes none."""
        written_us = max(0, stop.written_ns - stop.t_ns) / 1000
        how = f"by the {stop.by} after {written_us:.0f} us"
        if not stop.written_ns:
            wrote, level = "stop frame NOT written", "critical"
        elif held:
            wrote, level = f"stop frame handed over {how}, {NOT_SENT}", "critical"
        else:
            wrote, level = f"stop frame written {how}", ""
        fields = {
            **stop.cause.fields(),
            "noticed_by": stop.noticed_by,
            "written_by": stop.by if stop.written_ns else "nobody",
            "latency_us": round(written_us, 1) if stop.written_ns else None,
            "epoch": stop.epoch,
        }
        if ending:
            self.events.tell("stopping", f"{stop.cause}; {wrote}", fields, level=level)
        elif stop.behind is None:
            todo = f"{self.events.command('reset')}, then {self.events.command('enable')}"
            text = f"STOP latched: {stop.cause}; {wrote}; next: {todo}"
            self.events.tell("stop", text, fields, level=level)
        elif self._news_of(stop.cause):
            text = f"stopped again: {stop.cause}; {wrote}; latched is still: {stop.behind.cause}"
            self.events.tell("stop_again", text, {**fields, "latched": str(stop.behind.cause)}, level=level)

    def ready(self, granted: int) -> None:
        """Motion could be enabled, for the first time; `granted`: heartbeat bits, of what the supervisor has."""
        self._told_missing = ""
        todo = self.events.command("enable")
        self.events.tell("ready", f"{self._name!r} is ready: wheels stopped, motion disabled; next: {todo}")
        if not granted & heartbeat.REALTIME:
            self.events.tell("rights", f"{NO_REALTIME}; {self._advice}", {"what": "SCHED_FIFO"})
        if not granted & heartbeat.EARLY_NEWS:
            self.events.tell("rights", NO_EARLY_NEWS, {"what": "robust futexes"})

    def missing(self, missing: str, now_ns: int) -> None:
        """Once a turn: what motion waits for; told of when it stays away, and when it has come after all."""
        if missing != self._missing:
            self._missing, self._missing_ns = missing, now_ns
        if self._told_missing == missing:
            return
        if missing and now_ns - self._missing_ns >= WAITED_NS:
            self._told_missing = missing
            text = f"waiting for {missing}: motion can't be enabled; next: {self.events.command('status')}"
            self.events.tell("waiting", text, {"for": missing})
        elif not missing:
            self.events.tell("ready", f"{self._told_missing} is there now: motion can be enabled again")
            self._told_missing = ""

    def pass_notes(self) -> None:
        """Remarks that the processes have for people."""
        for process, ring in self._notes:
            while entry := ring.next():
                try:
                    note = Note.unpack(entry[2])
                except ValueError:
                    continue  # a damaged one: nothing depends on it
                self.events.tell(note.kind, note.text, {"process": process, **note.fields}, level=note.level)

    def ended(self, heard_ns: int, link: str, *, written: bool, sent: bool) -> None:
        """The service has ended. `heard_ns`: how long after the first stop the board acknowledged it, 0 for not; `link`
        as of stops.py; `written`: the kernel took the second stop; `sent`: it has passed it on."""
        told = "the stop was written twice" if sent else "the second stop could NOT be written"
        if written and not sent:
            told = f"the second stop was handed over, {NOT_SENT}"
        fields = {"link": link, "acknowledged_us": round(heard_ns / 1e3, 1) if heard_ns else None}
        if heard_ns:
            heard, level = f"acknowledged by the board after {heard_ns / 1e6:.1f} ms", ""
        elif link == UNPROVEN:
            heard, level = "whether the board hears is not known (link unproven)", "warning"
        else:
            heard, level = f"NOT acknowledged by the board (link {link}); wheels that turn: POWER SWITCH", "critical"
        self.events.tell("stopped", f"stopped; {told}, {heard}", fields, level=level if sent else "critical")

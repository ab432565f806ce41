"""Remarks: notes for people about requests, about drivers that stopped driving, and about the clients' reports on
themselves. Pure."""

from __future__ import annotations

from failstop.messages import records
from failstop.messages.packing import Note
from failstop.policy.causes import Reply
from failstop.procs.gate.sources import Command

SaidRow = tuple[int, int, str, int, str, str]
"""A client's report about itself: its session, slot, name, time (CLOCK_MONOTONIC ns), what it sees, and what is wrong
(empty if nothing is)."""

VERBS = {
    records.ENABLE: "enable",
    records.DISABLE: "disable",
    records.RESET: "reset",
    records.ARM_MOVE: "move the arm",
    records.ARM_DRIVE: "move the arm to its drive pose",
    records.ARM_TUCK: "tuck the arm",
    records.ARM_HOLD: "hold the arm",
    records.ARM_RELEASE: "release the arm",
    records.ARM_READ: "read the arm",
    records.LIMIT: "limit the speed",
}
CHANGES = frozenset(("enabled", "disabled", "reset"))
"""The kinds of notes about requests that have changed whether motion is enabled or a stop is latched. `failstop why`
finds out from them whether the last stop still explains why the wheels are stopped."""
MOST_AT_ONCE = 20
EVERY_NS = 200_000_000
"""The shortest time between two notes about requests, once MOST_AT_ONCE notes were made. So a client that repeats a
request endlessly causes five notes per second, not a thousand."""
AGES = ("ms", "s", "min", "h", "day", "days")
"""The units of the times in a client's report, as words.span writes them. _ageless() finds the times without a regular
expression, because importing `re` would slow each start of the gate."""
HALTS_AT_ONCE = 5
HALTS_EVERY_NS = 10_000_000_000
"""The shortest time between two notes about drivers that stopped driving, once HALTS_AT_ONCE notes were made. It is
long because some programs pause between two commands for longer than their timeout. The wheels start and stop again and
again, with a note for each stop."""


def of_request(verb: int, who: str, pid: int, reply: Reply, *, enabled: bool) -> Note | None:
    """Return the note about a request that was refused, or that has enabled or disabled motion, set the speed limit,
    released the arm or reset a stop. None for any other request. `enabled`: True if motion was enabled before the
    request."""
    by = f"{who} (pid {pid})" if pid else who
    fields: dict[str, str | int | float] = {"who": who, "pid": pid} if pid else {"who": who}
    named = VERBS.get(verb, str(verb))
    if not reply.done:
        return Note("refused", f"refused to {named}, {by}: {reply}", {**fields, "verb": named, "reason": str(reply)})
    if verb == records.ENABLE and not enabled:
        return Note("enabled", f"motion enabled by {by}", fields)
    if verb == records.DISABLE and enabled:
        return Note("disabled", f"motion disabled by {by}", fields)
    if verb == records.LIMIT:
        return Note("limit", f"{reply} by {by}", fields)
    if verb == records.ARM_RELEASE:
        return Note("arm", f"arm released by {by}", fields)
    if verb == records.RESET and reply.cause:
        return Note("reset", f"{by}: {reply}", {**fields, **reply.cause.fields()})
    return None


class Budget:
    """Limits the number of notes: `most` at once, and then one per `every_ns`."""

    def __init__(self, now_ns: int, most: int = MOST_AT_ONCE, every_ns: int = EVERY_NS) -> None:
        self._most = self._left = most
        self._every_ns = every_ns
        self._ns = now_ns
        self.unsaid = 0
        """How many notes were left out since this was last reported. The caller sets it to 0 again."""

    def spend(self, now_ns: int) -> bool:
        """Return True if one more note may be made now."""
        earned = (now_ns - self._ns) // self._every_ns
        self._ns += earned * self._every_ns
        self._left = min(self._most, self._left + earned)
        if not self._left:
            self.unsaid += 1
            return False
        self._left -= 1
        return True


def disabled_by_death(driver: Command, *, moved: bool) -> Note:
    """Return the note that a driver's death has disabled motion. It must always be logged, because motion stays
    disabled until somebody enables it. `moved`: True if the driver's commands have turned the wheels."""
    did = "died after it had driven" if moved else "died; it had commanded but not moved the robot"
    text = f"motion disabled: {driver.who} {did}"
    return Note("driver_gone", text, {"who": driver.who, "source": driver.source})


def disabled_by_silence(driver: Command, silent_ns: int) -> Note:
    """Return the note that a driver's silence has disabled motion. It must always be logged, because motion stays
    disabled until somebody enables it."""
    silent_ms = silent_ns / 1e6
    text = f"motion disabled: {driver.who} stopped sending commands {silent_ms:.0f} ms ago while it drove"
    fields = {"who": driver.who, "source": driver.source, "reason": text.partition(": ")[2]}
    return Note("disabled", text, {**fields, "silent_ms": round(silent_ms, 1)})


class DriverLosses:
    """Makes notes about drivers that stopped driving while motion stays enabled. Normal ends, such as letting go of a
    key, have their own budget, so they can't use up the budget for failing programs."""

    def __init__(self, now_ns: int) -> None:
        self._failed = Budget(now_ns, HALTS_AT_ONCE, HALTS_EVERY_NS)
        self._ended = Budget(now_ns, HALTS_AT_ONCE, HALTS_EVERY_NS)

    def silent(self, driver: Command, silent_ns: int, now_ns: int) -> list[Note]:
        """Return the notes about a driver that has sent no command for `silent_ns`, which is longer than its
        timeout."""
        silent_ms = silent_ns / 1e6
        last = f"last command {silent_ms:.0f} ms ago, so the wheels are told to stop"
        if driver.by_hand:
            return self._note("driver_ended", driver, f"let go: {last}", now_ns)
        text = f"stopped sending commands while it drove: {last}"
        return self._note("driver_silent", driver, text, now_ns, silent_ms=round(silent_ms, 1))

    def gone(self, driver: Command, now_ns: int, *, parted: bool) -> list[Note]:
        """Return the notes about a driver that has left or died. `parted`: True if its client said goodbye, so the
        driver has ended normally."""
        if parted:
            return self._note("driver_ended", driver, "ended its command, so the wheels are told to stop", now_ns)
        return self._note("driver_gone", driver, "ended or died while it drove, so the wheels are told to stop", now_ns)

    def _note(self, kind: str, driver: Command, text: str, now_ns: int, **fields: float) -> list[Note]:
        budget = self._ended if kind == "driver_ended" else self._failed
        if not budget.spend(now_ns):
            return []
        return [Note(kind, f"{driver.who} {text}", {"who": driver.who, "source": driver.source, **fields})]


class SelfReports:
    """Keeps each session's last report about itself: what its program sees, and what is wrong. The reports are only for
    people."""

    def __init__(self, now_ns: int) -> None:
        self._rows: dict[int, SaidRow] = {}
        self._parted: set[int] = set()
        """The sessions that have said goodbye since the last update."""
        self._budget = Budget(now_ns)

    def part(self, session: int) -> None:
        """Record that a session has said goodbye, so that update() does not report its program as gone. The program may
        still run. For example, the guard ends its session to free a slot for a driver."""
        self._parted.add(session)

    def update(self, rows: list[SaidRow], now_ns: int) -> list[Note] | None:
        """Replace all reports by `rows`. Returns notes for people, or None if nothing has changed, not even a report's
        time."""
        before, self._rows = self._rows, {row[0]: row for row in rows}
        if before == self._rows:
            return None
        notes = [note for session, row in self._rows.items() if (note := _words(before.get(session), row))]
        ended = ((row, session in self._parted) for session, row in before.items() if session not in self._rows)
        notes += [note for row, parted in ended if (note := _gone(row, parted=parted))]
        self._parted.clear()
        return [note for note in notes if self._budget.spend(now_ns)]

    def table(self) -> list[tuple[int, int, str, str]]:
        """Return the report of each session as (slot, time, what it sees, what is wrong)."""
        return [(slot, t_ns, sees, wrong) for _, slot, _, t_ns, sees, wrong in self._rows.values()]


def _ageless(text: str) -> list[str]:
    """Return the words of a report without times such as `3 s`. A report that has merely become older must not cause
    another note, because such notes would fill the log."""
    kept: list[str] = []
    for word in text.split(" "):
        if kept and word.rstrip(";,.") in AGES and kept[-1].replace(".", "", 1).isdecimal():
            kept.pop()
        else:
            kept.append(word)
    return kept


def _words(before: SaidRow | None, row: SaidRow) -> Note | None:
    _, _, who, _, sees, wrong = row
    if before and [*map(_ageless, before[4:])] == [*map(_ageless, row[4:])]:
        return None
    fields: dict[str, str | int | float] = {"who": who, "sees": sees, "wrong": wrong}
    if wrong and (before is None or _ageless(before[5]) != _ageless(wrong)):
        return Note("said", f"{who}: {wrong}", fields, level="warning")
    return Note("said", f"{who}: {sees}", fields)


def _gone(row: SaidRow, *, parted: bool) -> Note | None:
    """Return the note about a session that has ended. After a goodbye, there is a note only if its last report named
    something wrong."""
    _, _, who, _, _, wrong = row
    text = f"{who} has gone"
    if parted:
        if not wrong:
            return None
        text = f"{who} no longer reports: {wrong}"
    return Note("said", text, {"who": who, "sees": "", "wrong": ""})

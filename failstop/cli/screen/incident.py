"""Shows a saved incident on a terminal. It makes lines of text from the incident's file. Pure."""

from __future__ import annotations

from typing import Any

from failstop.api import words
from failstop.cli import style
from failstop.cli.style import DIM, FAIL, PLAIN, STRONG, WARN
from failstop.incidents import files, memory, story
from failstop.incidents.incident import DRIVING, SAYS, Incident, WriteSort, named
from failstop.incidents.story import CAUSE
from failstop.messages.records import printable
from failstop.policy import causes
from failstop.policy.settings import Settings

Lines = list[list[tuple[str, str]]]
Fact = tuple[str, str, str]
"""One fact of an incident: its name, its text, and its role (colour)."""

MORE = "--all shows the rest; `plot` instead of `show` draws it"
NARROWEST = 60
LABEL = 10
LEAD = 2 + 10 + 2 + LABEL + 2
"""The width of what comes before the text in a row of the story: indent, time, gap, label, gap."""
READINGS = {"board_s": "board", "wheels_s": "wheels", "imu_s": "IMU", "battery_s": "battery", "servos_s": "servos"}
"""For each name in Incident.ages(), the word that people see."""
LEAST_APART_NS = 100_000
"""If a stop's first and last bytes are at least this far apart, in ns, the screen shows both times. Otherwise it shows
only the time of the last bytes."""
PROOFS = {True: PLAIN, None: WARN, False: FAIL}
ROLES = {CAUSE: FAIL, "gate": STRONG, "beat": WARN, "board": WARN, "stop": FAIL, "died": FAIL, "fenced": FAIL}


def table(heads: list[dict[str, Any]], columns: int) -> Lines:
    """Return the list of incidents, the newest last. Each has its id, its time, its cause, and the proof of its stop.
    If the wall clock jumped before an incident, that incident also has a note."""
    lines: Lines = []
    for head in heads:
        role = FAIL if any(proven is False for _, proven in memory.proofs(head)) else DIM
        lines.append([(words.printable(head["id"]), STRONG)])
        lines += _wrapped("  ", f"{words.clock(head['t'])}  {head['reason']}", PLAIN, columns)
        lines += _wrapped("  ", memory.proven(head), role, columns)
        if note := files.jumped(head):
            lines += _wrapped("  ", note, WARN, columns)
    return lines


def text(incident: Incident, columns: int, now_s: float, *, whole: bool = False, clock: str = "") -> Lines:
    """Return the lines about one incident: the facts and the important part of the story, few enough to need no
    scrolling. With `whole`, return the facts, the whole story, and the circumstances. `clock`: why the times of day may
    be wrong; empty if they are right."""
    columns = max(columns, NARROWEST)
    return [
        *_facts(f"Incident {words.printable(incident.id)}", _head(incident, now_s, clock), columns),
        [],
        *_story(incident, columns, whole=whole),
        *([[], *_facts("Around it", _around(incident), columns)] if whole else [[(MORE, DIM)]]),
    ]


def _wrapped(lead: str, text: str, role: str, columns: int) -> Lines:
    """Wrap a text into rows. The first row begins with `lead`, and the other rows are indented by its width."""
    return style.wrap([(lead, PLAIN), (printable(text), role)], columns, len(lead))


def _facts(title: str, rows: list[Fact], columns: int) -> Lines:
    wrapped = (_wrapped(f"  {name:<10}", said, role, columns) for name, said, role in rows)
    return [[(title, STRONG)], *(line for lines in wrapped for line in lines)]


def _head(incident: Incident, now_s: float, clock: str) -> list[Fact]:
    """Return the facts: what happened and when, which process noticed it, and one line for each proof of the stop."""
    head = incident.head
    ago = f", {words.span(now_s - head['t'])} ago" if now_s >= head["t"] else ""
    by = (head["stop"] or {}).get("noticed_by") or {ns: who for ns, who, _ in incident.stops}.get(incident.cause_ns)
    noticed = f"by the {named(by)}" if by else memory.NOT_KNOWN
    if incident.cause.kind in causes.SIGNED:
        asked = incident.cause.named()
        noticed += f"; the program says it is {asked['who']} (pid {asked['pid']})"
    rows = [
        ("why", incident.why, FAIL),
        ("when", f'{words.clock(head["t"])}{ago}; service "{head["name"]}" on {head["host"]}', PLAIN),
        ("before", _before(incident), PLAIN),
        *_wheels(incident),
        ("noticed", noticed, PLAIN),
    ]
    if clock:
        rows.insert(2, ("clock", clock, WARN))
    first, *rest = memory.proofs(head)
    rows.append(("proof", f"{first[0]}{_first_frame(incident) if first[1] else ''}", PROOFS[first[1]]))
    rows += [("", said, PROOFS[proven]) for said, proven in rest]
    if incident.left:
        rows.append(
            (
                "note",
                "The supervisor had died, so this was saved at the next start, from what the run had left in memory.",
                WARN,
            )
        )
    if incident.foreign:
        version = f"Saved by failstop {head['versions']['failstop']}, which stored its records differently"
        rows.append(("note", f"{version}, so this shows only the logged events.", WARN))
    if incident.undecoded:
        rows.append(("damaged", f"{incident.undecoded} records could not be decoded", WARN))
    return rows


def _first_frame(incident: Incident) -> str:
    """Return a text with the time of the stop's first bytes. Empty if the last bytes came less than LEAST_APART_NS
    later, because the screen shows the time of the last bytes anyway."""
    written_us = (incident.head["stop"] or {}).get("written_us")
    bursts = (write.ns for write in incident.writes if write.sort == WriteSort.STOP_BURST and write.taken)
    first_ns = next((ns for ns in bursts if ns >= incident.cause_ns), None)
    if written_us is None or first_ns is None or written_us * 1000 - (first_ns - incident.cause_ns) < LEAST_APART_NS:
        return ""
    return f" (its first bytes after {words.took((first_ns - incident.cause_ns) / 1e9)})"


def _before(incident: Incident) -> str:
    """Describe the last command that drove before the cause. If nothing drove the robot, say for how long zero had been
    commanded."""
    ticks = [tick for tick in incident.ticks if tick.ns <= incident.cause_ns]
    if not ticks:
        return memory.NOT_KNOWN
    last = ticks[-1]
    if last.block == DRIVING:
        how = words.velocity(*last.velocity) or "zero"
        if (driver := incident.driver(last)) is None:
            return f"driving, {how}; not for {last.who} as {last.source}, which sent the newest command"
        age_ms = (driver.age_us or 0) / 1e3 + (incident.cause_ns - driver.ns) / 1e6
        return f"driving, {how}; {driver.who} as {driver.source}, command {age_ms:.0f} ms old"
    driven = [tick.ns for tick in ticks if tick.block == DRIVING]
    least = "" if driven else "at least "
    stood_s = (incident.cause_ns - (driven[-1] if driven else ticks[0].ns)) / 1e9
    return f"zero was commanded ({SAYS.get(last.block, last.block)}), for {least}{words.took(stood_s)}"


def _wheels(incident: Incident) -> list[Fact]:
    """Describe the board's last report about its wheels before the cause, and its reports until the end of the file.
    All times are those of reports, because nobody knows what the wheels did between two reports."""
    spans = incident.rolled()
    if not spans:
        return []
    before = [span for span in spans if span[1] <= incident.cause_ns]
    turn, _, end_ns, fastest_rps, _ = spans[-1]
    first = "not reported before"
    if before:
        first = f"turned, at most {before[-1][3]:.2f} turns/s" if before[-1][0] else "were still"
        first += words.aged((incident.cause_ns - before[-1][2]) / 1e9).replace("ago", "before")
    by = "(by the board's reports)"
    if turn:
        after = f"TURNED at the last report, {_when(incident, end_ns)} it"
        return [("wheels", f"{first}; {after}: at most {fastest_rps:.2f} turns/s {by}", FAIL)]
    turned_ns = max((span[2] for span in spans if span[0]), default=0)
    still_ns = min(span[1] for span in spans if span[1] > turned_ns)
    rest = ""
    if still_ns > incident.cause_ns:
        until = f"seen turning until {_when(incident, turned_ns)} the cause, " if turned_ns else ""
        rest = f"; {until}seen still {_when(incident, still_ns)} it"
        if turned_ns and still_ns - turned_ns > incident.wheels_gap_ns:
            rest += ", no report between"
    return [("wheels", f"{first}{rest} {by}", PLAIN)]


def _story(incident: Incident, columns: int, *, whole: bool) -> Lines:
    """Return the lines of the story: the events around the stop, in the order of time. An event that is too
    long for one row is cut, or wrapped if `whole`."""
    found: Lines = [[("Story", STRONG), (", in ms from the cause; of repeated lines, the last", PLAIN)]]
    for line in story.whole(incident) if whole else story.brief(incident):
        cause = line.what == CAUSE
        at = f">>{0:>10}  " if cause else f"  {incident.ms(line.ns):>+10.1f}  "
        label = printable(f"{line.what.partition('_')[0]:<{LABEL}.{LABEL}}  ")
        said = printable(line.text)
        more = f" ({line.count} x until {incident.ms(line.until_ns):+.1f})" if line.count > 1 else ""
        if not whole:
            said = style.cut(said, columns - LEAD - len(more))
        told = FAIL if cause else PLAIN
        found += style.wrap([(at, told), (label, ROLES.get(line.what, PLAIN)), (said + more, told)], columns, LEAD)
    return found


def _when(incident: Incident, ns: int) -> str:
    """Return how long before or after the cause this time is, in words."""
    return f"{words.took(abs(ns - incident.cause_ns) / 1e9)} {'before' if ns < incident.cause_ns else 'after'}"


def _battery(incident: Incident) -> str:
    """Return the last reading of the battery with its time, and the lowest reading."""
    if not incident.battery_v:
        return memory.NOT_KNOWN
    ns, volts = incident.battery_v[-1]
    least = min(volts for _, volts in incident.battery_v)
    return f"{volts:.2f} V, read {_when(incident, ns)} the cause; lowest {least:.2f} V"


def _ages(incident: Incident) -> str:
    """Say how old the newest reading of each kind, for example the battery's, was at the time of the cause."""
    ages = {READINGS[name]: age_s for name, age_s in incident.ages().items() if age_s is not None}
    old = ", ".join(f"{name} {words.took(age_s)}" for name, age_s in ages.items())
    return f"age of the newest one at the cause: {old}" if old else memory.NOT_KNOWN


def _around(incident: Incident) -> list[Fact]:
    """Return the circumstances: battery, readings, computer, settings and versions. They may help if the story does not
    explain the cause."""
    usual = Settings().lines().splitlines()
    changed = [f"{key} = {value}" for key, value in incident.settings.items() if f"{key}={value}" not in usual]
    return [
        ("battery", _battery(incident), PLAIN),
        ("readings", _ages(incident), PLAIN),
        ("machine", ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in incident.machine.items()), PLAIN),
        ("settings", ", ".join(changed) or "all defaults", PLAIN),
        ("versions", ", ".join(f"{name} {value}" for name, value in incident.head["versions"].items()), PLAIN),
    ]

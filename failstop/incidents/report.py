"""Report: an incident for people, as lines of a terminal (cli/style.py) of 80 columns or what there is. Pure."""

from __future__ import annotations

import time
from typing import Any

from failstop.api.words import span, took
from failstop.cli import style
from failstop.cli.style import DIM, FAIL, PLAIN, STRONG, WARN
from failstop.incidents import memory, story
from failstop.incidents.incident import DRIVING, SAYS, Incident
from failstop.incidents.story import CAUSE
from failstop.policy import causes
from failstop.policy.settings import Settings
from failstop.shm.records import printable
from failstop.supervisor.stops import wheels_seen

Lines = list[list[tuple[str, str]]]
Fact = tuple[str, str, str]
"""Its name, what it says, and its role."""

NARROWEST = 60
LABEL = 10
LEAD = 2 + 10 + 2 + LABEL + 2
"""Columns in front of a line's text: indent, time, gap, label, gap."""
NOT_KNOWN = "not known"
DRIVER_ENDS = ("driver_silent", "driver_gone", "driver_ended")
TICK_NS = 100_000_000
"""The gate's decision and its word on it belong together when they are no further apart."""
LATE_S = 0.1
"""A stop that is written later than this is worth a look."""
ROLES = {CAUSE: FAIL, "gate": STRONG, "beat": WARN, "stop": FAIL, "died": FAIL, "fenced": FAIL, "command": ""}
ROLES |= {"wire": DIM, "board": DIM}
SHORT = {"device_lost": "device", "device_back": "device"} | dict.fromkeys(DRIVER_ENDS, "driver")


def when(unix_s: float) -> str:
    """Local time, as people read it."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(unix_s))


def table(heads: list[dict[str, Any]], columns: int) -> Lines:
    """The list of incidents, the newest last: id, when, why, and how the stop was proven, below each other."""
    lines: Lines = []
    for head in heads:
        said = memory.proof(head["stop"], head)
        lines.append([(head["id"], STRONG)])
        lines += _wrapped("  ", f"{when(head['t'])}  {head['reason']}", PLAIN, columns)
        lines += _wrapped("  ", said, FAIL if "NOT " in said else DIM, columns)
    return lines


def summary(incident: Incident, columns: int, since_ns: int, now_s: float, again: str = "") -> Lines:
    """What matters, without scrolling: the facts, and the lines of the story that led to the stop and came of it;
    `again`: the words that name the incident on a command line."""
    columns = max(columns, NARROWEST)
    return [
        *_facts(f"Incident {incident.id}", _head(incident, now_s), columns),
        *_story(incident, story.brief(incident, since_ns), columns, short=True),
        *_wrapped("", f"--all tells the rest; a picture: `failstop incident plot{again}`", DIM, columns),
    ]


def text(incident: Incident, columns: int, since_ns: int, now_s: float) -> Lines:
    """The whole report."""
    columns = max(columns, NARROWEST)
    begin_ms, end_ms = map(incident.ms, incident.span_ns)
    recorded = f"from {-begin_ms / 1e3:.1f} s before to {end_ms / 1e3:.1f} s after"
    return [
        *_facts(f"Incident {incident.id}", [*_head(incident, now_s), ("recorded", recorded, PLAIN)], columns),
        *_story(incident, story.within(story.tell(incident), since_ns), columns),
        [],
        [("Processes", STRONG), (", as the file was saved", PLAIN)],
        *([("  ", PLAIN), *row] for row in style.table(_processes(incident))),
        [],
        *_facts("Around it", _around(incident), columns),
    ]


def _wrapped(lead: str, text: str, role: str, columns: int) -> Lines:
    """A text behind what leads it, as wide as that from its second row on."""
    return style.wrap([(lead, PLAIN), (printable(text), role)], columns, len(lead))


def _facts(title: str, rows: list[Fact], columns: int) -> Lines:
    wrapped = (_wrapped(f"  {name:<14}", said, role, columns) for name, said, role in rows)
    return [[(title, STRONG)], *(line for lines in wrapped for line in lines)]


def _head(incident: Incident, now_s: float) -> list[Fact]:
    """The facts: what, when, and the three times of the stop, which are kept apart."""
    head = incident.head
    ago = f", {span(now_s - head['t'])} ago" if now_s >= head["t"] else ""
    by = story.noticed_by(incident)
    noticed = f"by the {by}" if by else NOT_KNOWN
    if incident.cause.kind is causes.REQUESTED:
        asked = incident.cause.named()
        noticed += f"; asked for by {asked['who']} (pid {asked['pid']})"
    rows = [
        ("why", incident.why, FAIL),
        ("when", f'{when(head["t"])}{ago}; service "{head["name"]}" on {head["host"]}', PLAIN),
        ("before", _before(incident), PLAIN),
        ("noticed", noticed, PLAIN),
        *_proofs(incident),
    ]
    if head["kind"] == "left":
        rows.append(("note", "The supervisor was gone: saved at the next start from what its run had left.", WARN))
    if incident.foreign:
        version = f"Of failstop {head['versions']['failstop']}, which laid its records out otherwise"
        rows.append(("note", f"{version}: what was told, no more.", WARN))
    if incident.undecoded:
        rows.append(("damaged", f"{incident.undecoded} records could not be decoded", WARN))
    return rows


def _before(incident: Incident) -> str:
    """What the robot did when it happened, and since when it stood."""
    ticks = [tick for tick in incident.ticks if tick.ns <= incident.cause_ns]
    if not ticks:
        return NOT_KNOWN
    last = ticks[-1]
    if last.block == DRIVING:
        age_ms = (last.age_us or 0) / 1e3 + (incident.cause_ns - last.ns) / 1e6
        return f"driving, {story.velocity(last.velocity)}; {last.who} as {last.source}, command {age_ms:.0f} ms old"
    driven_ns = max((tick.ns for tick in ticks if tick.block == DRIVING), default=0)
    since_ns = next(tick.ns for tick in ticks if tick.ns > driven_ns)
    # What was told before they turned for the last time explains nothing.
    least = "" if driven_ns else "at least "
    why = SAYS.get(last.block, last.block)
    stood = f"the wheels stood ({why}), for {least}{took((incident.cause_ns - since_ns) / 1e9)}"
    ended = [e.text for e in incident.events if e.kind in DRIVER_ENDS and e.ns <= since_ns + TICK_NS]
    return f"{stood}; {ended[-1]}" if driven_ns and ended else stood


def _proofs(incident: Incident) -> list[Fact]:
    """Written, acknowledged, observed: by whom, and when after the cause."""
    stop = incident.proven() or {}
    recorded = took(max(0.0, incident.ms(incident.span_ns[1]) / 1e3))
    written = ("written", f"NOT within the {recorded} that are recorded after the cause", FAIL)
    heard = ("acknowledged", f"{NOT_KNOWN}: no answer of the board to it is recorded", WARN)
    seen = ("observed", f"{NOT_KNOWN}: the IMU said nothing of it that is recorded", WARN)
    if not stop:
        written = ("written", f"{NOT_KNOWN}: nobody of the service has told of it, nor is it recorded", FAIL)
    elif stop.get("written_us") is not None:
        by = f"by the {story.name(stop['written_by'])}, " if stop.get("written_by") else ""
        after_s = stop["written_us"] / 1e6
        # Why it could not be written sooner, if that is known.
        near = [e for e in incident.events if abs(incident.ms(e.ns) / 1e3 - after_s) < TICK_NS / 1e9]
        late = ", when the port was back" if any(e.kind == "device_back" for e in near) else ""
        written = ("written", f"{by}after {took(after_s)}{late}", WARN if after_s > LATE_S else PLAIN)
    if (heard_us := stop.get("acknowledged_us")) is not None:
        heard = ("acknowledged", f"by the board, after {took(heard_us / 1e6)}", PLAIN)
    if (seen_ms := stop.get("observed_ms")) is not None:
        seen = ("observed", f"by the IMU: {wheels_seen(seen_ms / 1e3)}", PLAIN)
    elif stop.get("wheels") == "unstill":
        seen = ("observed", f"by the IMU: {memory.UNSTILL}", FAIL)
    return [written, heard, seen]


def _story(incident: Incident, lines: list[story.Line], columns: int, *, short: bool = False) -> Lines:
    found: Lines = [[], [("Story", STRONG), (", milliseconds from the cause", PLAIN)]]
    for line in lines:
        label = SHORT.get(line.what, printable(line.what.removeprefix("stop_").replace("_", " "))[:LABEL])
        label, role = f"{label:<{LABEL}}  ", ROLES.get(line.what, PLAIN)
        said = printable(line.text)
        if line.what == CAUSE:
            found += style.wrap([(f">>{'0':>10}  {label}{said}", role)], columns, LEAD)
            continue
        until = f"until {incident.ms(line.until_ns):+.1f}"
        more = f" ({line.count} x {until})" if line.count > 1 else ""
        if short:
            if more and LEAD + len(said + more) > columns:
                more = f" ({until})"
            said = style.cut(said, columns - LEAD - len(more))
        lead = (f"  {incident.ms(line.ns):>+10.1f}  ", PLAIN)
        found += style.wrap([lead, (label, role), (said + more, PLAIN)], columns, LEAD)
    return found


def _processes(incident: Incident) -> Lines:
    end_ns = incident.span_ns[1]
    rows = [("", " pid", "state", " last beat", " worst turn", " restarts", "last exit")]
    for name, row in incident.processes().items():
        ago_ms = max(0.0, (end_ns - row["beat_ns"]) / 1e6)
        times = (f" {ago_ms:.0f} ms", f" {row['worst_ms']:.1f} ms", f" {row['restarts']}")
        rows.append((name, f" {row['pid']}", row.get("state", ""), *times, row["last_exit"] or ""))
    return [[(text, PLAIN) for text in row] for row in rows]


def _around(incident: Incident) -> list[Fact]:
    """Machine, settings, versions: what is wanted once the story has raised a question."""
    machine = incident.machine
    state = [f"load {' '.join(f'{value:g}' for value in machine.get('load', []))} on {machine.get('cores')} cores"]
    if "available_mb" in machine:
        state.append(f"{machine['available_mb']} MB of memory available")
    state += [
        f"{value:g} % of the time something waited for {key.split('_')[1]}"
        for key, value in machine.items()
        if key.startswith("pressure_") and value >= 1
    ]
    usual = Settings().lines().splitlines()
    changed = [f"{key} = {value}" for key, value in incident.settings.items() if f"{key}={value}" not in usual]
    of = "of the run that saved it; " if incident.head["kind"] == "left" else ""
    settings = f"{of}{', '.join(changed) or 'all as by default'} ({len(incident.settings)} in all: --json)"
    versions = ", ".join(f"{name} {value}" for name, value in incident.head["versions"].items())
    return [("machine", ", ".join(state), PLAIN), ("settings", settings, PLAIN), ("versions", versions, PLAIN)]


def as_dict(incident: Incident) -> dict[str, Any]:
    """For programs: everything of the report, and every setting."""
    gate = incident.latest_map("gate", "state")
    if isinstance(packed := gate.get("estop"), bytes):
        gate["estop"] = str(causes.read(packed))
    lines = [
        {
            "ms": round(incident.ms(line.ns), 3),
            "until_ms": round(incident.ms(line.until_ns), 3) if line.until_ns else None,
            "what": line.what,
            "text": line.text,
            "count": line.count,
        }
        for line in story.tell(incident)
    ]
    found = {"id": incident.id, **incident.head, "story": lines, "processes": incident.processes(), "gate": gate}
    return {**found, "machine": incident.machine, "settings": incident.settings}

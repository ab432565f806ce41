"""Report: an incident as text for people, in 80 columns or what there is. Pure but for the colours (style.py)."""

from __future__ import annotations

import time
from textwrap import wrap
from typing import Any

from failstop.incidents import story
from failstop.incidents.incident import Incident
from failstop.incidents.story import CAUSE, Line
from failstop.shm.records import printable
from failstop.style import DIM, FAIL, STRONG, WARN, paint
from failstop.supervisor.settings import BY_KEY, declaration
from failstop.supervisor.stops import wheels_seen

NARROWEST = 60
LABEL = 10
LEAD = 2 + 10 + 2 + LABEL + 2
"""Columns in front of a line's text: indent, time, gap, label, gap."""
ROLES = {CAUSE: FAIL, "gate": STRONG, "beat": WARN, "stop": FAIL, "died": FAIL, "fenced": FAIL, "command": ""}
SHORT = {
    "stop_outcome": "outcome",
    "stop_again": "again",
    "stop_also": "also",
    "device_lost": "device",
    "device_back": "device",
}


def proof(stop: dict[str, Any] | None) -> str:
    """How the stop was proven, the three levels in a few words."""
    if stop is None:
        return "not known"
    by = stop.get("written_by")
    parts = ["NOT written"]
    if stop.get("written_us") is not None:
        parts = [f"written {f'by the {by} ' if by else ''}after {duration(stop['written_us'] / 1e6)}"]
    if (heard_us := stop.get("acknowledged_us")) is not None:
        parts.append(f"acknowledged after {duration(heard_us / 1e6)}")
    if (seen_ms := stop.get("observed_ms")) is not None:
        parts.append(wheels_seen(seen_ms / 1e3))
    elif stop.get("wheels") == "unstill":
        parts.append("wheels NOT seen still")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """A short time with three figures or so."""
    if seconds < 0.001:
        return f"{seconds * 1e6:.0f} us"
    if seconds < 1:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.1f} s"


def when(unix_s: float) -> str:
    """Local time, as people read it."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(unix_s))


def table(heads: list[dict[str, Any]], columns: int) -> list[str]:
    """The list of incidents, the newest last: id, when, why, and how the stop was proven, below each other where both
    do not fit."""
    lines = []
    for head in heads:
        lines.append(f"{paint(head['id'], STRONG)}")
        lines += wrap(
            f"{when(head['t'])}  {printable(head['reason'])}", columns, initial_indent="  ", subsequent_indent="  "
        )
        said = wrap(f"stop {proof(head['stop'])}", columns, initial_indent="  ", subsequent_indent="  ")
        lines += [paint(line, DIM) for line in said]
    return lines


def text(incident: Incident, columns: int, since_ns: int) -> list[str]:
    """The whole report."""
    columns = max(columns, NARROWEST)
    lines = story.tell(incident)
    return [
        *_head(incident, columns),
        "",
        paint("Story", STRONG) + ", milliseconds from the cause",
        *(row for line in story.within(lines, since_ns) for row in _row(incident, line, columns)),
        "",
        paint("Processes", STRONG) + ", as the file was saved",
        *_processes(incident),
        "",
        *_rest(incident, columns),
    ]


def _facts(pairs: list[tuple[str, str]], columns: int) -> list[str]:
    lines = []
    for name, value in pairs:
        first, *rest = wrap(printable(value), columns - 13) or [""]
        lines += [f"  {name:<9}  {first}", *(" " * 13 + line for line in rest)]
    return lines


def _head(incident: Incident, columns: int) -> list[str]:
    head = incident.head
    begin_ns, end_ns = incident.span_ns()
    pairs = [
        ("when", f'{when(head["t"])} on {head["host"]}, service "{head["name"]}"'),
        ("why", incident.reason),
        ("stop", proof(head["stop"])),
        ("before", _before(incident)),
        ("recorded", f"from {-incident.ms(begin_ns) / 1e3:.1f} s before to {incident.ms(end_ns) / 1e3:.1f} s after"),
    ]
    if head["kind"] == "left":
        pairs.insert(2, ("", "The supervisor was gone: saved at the next start from what its run had left."))
    if incident.undecoded:
        pairs.append(("damaged", f"{incident.undecoded} records could not be decoded"))
    return [f"{paint('Incident', STRONG)} {paint(incident.id, STRONG)}", "", *_facts(pairs, columns)]


def _before(incident: Incident) -> str:
    """What the robot did when it happened."""
    ticks = [tick for tick in incident.ticks if tick.ns <= incident.cause_ns]
    if not ticks:
        return "not known"
    last = ticks[-1]
    if last.block != "driving":
        return f"the wheels stood: {last.block}"
    age_ms = (last.age_us or 0) / 1e3 + (incident.cause_ns - last.ns) / 1e6
    return f"driving, {story.velocity(last.velocity)}; {last.who} as {last.source}, command {age_ms:.0f} ms old"


def _row(incident: Incident, line: Line, columns: int) -> list[str]:
    cause = line.what == CAUSE
    label = printable(SHORT.get(line.what, line.what)[:LABEL])
    more = _more(incident, line)
    first, *rest = wrap(printable(line.text) + more, columns - LEAD) or [""]
    stamp = f"{incident.ms(line.ns):>+10.1f}" if not cause else f"{'0':>10}"
    role = ROLES.get(line.what, DIM if line.what in ("wire", "board") else "")
    if cause:
        return [paint(f">>{stamp}  {label:<{LABEL}}  {first}", role), *(paint(" " * LEAD + row, role) for row in rest)]
    return [f"  {stamp}  {paint(f'{label:<{LABEL}}', role)}  {first}", *(" " * LEAD + row for row in rest)]


def _more(incident: Incident, line: Line) -> str:
    """How often, and until when."""
    if line.count < 2:
        return ""
    return f" ({line.count} x until {incident.ms(line.until_ns):+.1f})"


def _processes(incident: Incident) -> list[str]:
    end_ns = incident.span_ns()[1]
    lines = [f"  {'':<10} {'pid':>7}  {'state':<8} {'last beat':>9} {'worst turn':>10} {'restarts':>8}  last exit"]
    for name, row in incident.processes().items():
        ago_ms = max(0.0, (end_ns - row["beat_ns"]) / 1e6)
        state = row.get("state", "")
        lines.append(
            f"  {name:<10} {row['pid']:>7}  {state:<8} {ago_ms:>6.0f} ms {row['worst_ms']:>7.1f} ms"
            f" {row['restarts']:>8}  {row['last_exit'] or ''}".rstrip()
        )
    return lines


def _rest(incident: Incident, columns: int) -> list[str]:
    """Machine, settings, versions: what is wanted once the story has raised a question."""
    machine, versions = incident.machine, incident.head["versions"]
    load = " ".join(f"{value:g}" for value in machine.get("load", []))
    state = [f"load {load} on {machine.get('cores')} cores"]
    if "available_mb" in machine:
        state.append(f"{machine['available_mb']} MB of memory available")
    state += [
        f"{value:g} % of the time something waited for {key.split('_')[1]}"
        for key, value in machine.items()
        if key.startswith("pressure_") and value >= 1
    ]
    changed = {key: value for key, value in incident.settings.items() if _default(key) != value}
    shown = ", ".join(f"{key} = {value}" for key, value in changed.items())
    of = "of the run that saved it; " if incident.head["kind"] == "left" else ""
    pairs = [
        ("machine", ", ".join(state)),
        ("settings", f"{of}{shown or 'all as by default'} ({len(incident.settings)} in all: --json)"),
        ("versions", ", ".join(f"{name} {value}" for name, value in versions.items())),
    ]
    return [paint("Around it", STRONG), *_facts(pairs, columns)]


def _default(key: str) -> str | None:
    """What a setting is when nobody sets it; None for those of tables that somebody named."""
    try:
        setting = BY_KEY.get(key) or (declaration(key) if key.startswith("sources.cmd_vel.") else None)
    except ValueError:
        return None
    return str(setting.default) if setting else None


def as_dict(incident: Incident) -> dict[str, Any]:
    """For programs: everything of the report, and every setting."""
    return {
        "id": incident.id,
        **incident.head,
        "story": [
            {
                "ms": round(incident.ms(line.ns), 3),
                "until_ms": round(incident.ms(line.until_ns), 3) if line.until_ns else None,
                "what": line.what,
                "text": line.text,
                "count": line.count,
            }
            for line in story.tell(incident)
        ],
        "processes": incident.processes(),
        "gate": incident.latest_map("gate", "state"),
        "machine": incident.machine,
        "settings": incident.settings,
    }

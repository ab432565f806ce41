"""Shades: behind a picture's curves, what the gate said - and where it said nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from failstop.incidents import signals
from failstop.incidents.incident import Incident
from failstop.incidents.palette import FAINT, GRID, PAPER
from failstop.shm import blocks, layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Span = tuple[str, int, int]
"""What the gate said, from when, until when (CLOCK_MONOTONIC ns)."""

DRIVING = "driving"
SILENT = "silent"
HATCH: dict[str, Any] = {"facecolor": "#eef0f3", "edgecolor": "#d3d9df", "hatch": "////", "linewidth": 0}
SHADES: dict[str, tuple[str, dict[str, Any]]] = {
    DRIVING: ("the wheels may turn", {"facecolor": PAPER, "edgecolor": GRID}),
    "estop": ("a stop is latched", {"facecolor": "#fdeaea", "linewidth": 0}),
    blocks.DISABLED: ("motion is disabled", {"facecolor": "#eceff3", "linewidth": 0}),
    blocks.NO_COMMAND: ("no command", {"facecolor": "#fff3d1", "linewidth": 0}),
    blocks.NO_SCAN: ("no obstacle sensor", {"facecolor": "#e3effa", "linewidth": 0}),
    SILENT: ("the gate is silent", HATCH),
}
"""By what the gate says: words for the legend, and how it is drawn."""


def spans(incident: Incident) -> list[Span]:
    """What the gate said over time, without gaps; where it missed its ticks or was dead, SILENT."""
    allowed = signals.allowed_ns(incident, layout.GATE)
    deaths = [
        event.ns for event in incident.events if event.kind == "died" and event.fields.get("process") == layout.GATE
    ]
    found: list[Span] = []

    def add(what: str, begin_ns: int, end_ns: int) -> None:
        if found and found[-1][0] == what:
            begin_ns = found.pop()[1]
        found.append((what, begin_ns, end_ns))

    for tick, after in pairwise(incident.ticks):
        dead = any(tick.ns < ns < after.ns for ns in deaths)
        add(SILENT if dead or after.ns - tick.ns > allowed else tick.block, tick.ns, after.ns)
    end_ns = incident.span_ns()[1]
    if incident.ticks and end_ns - incident.ticks[-1].ns > allowed:
        add(SILENT, incident.ticks[-1].ns, end_ns)
    return found


def draw(axes: Axes, incident: Incident, per_ms: float) -> None:
    """Behind one pair of axes; `per_ms` turns milliseconds from the cause into their unit."""
    for what, begin_ns, end_ns in spans(incident):
        if what != DRIVING and what in SHADES:
            begin, end = (incident.ms(ns) * per_ms for ns in (begin_ns, end_ns))
            axes.axvspan(begin, end, zorder=0, **SHADES[what][1])


def legend(figure: Figure, incident: Incident, since_ns: int, y: float) -> None:
    """One row: what each shade means that is in the picture from `since_ns` on, its bottom at `y` of the figure."""
    from matplotlib.patches import Patch

    there = {what for what, _, end_ns in spans(incident) if end_ns >= since_ns}
    patches = [Patch(label=words, **style) for what, (words, style) in SHADES.items() if what in there]
    if patches:
        figure.legend(
            handles=patches, loc="lower left", bbox_to_anchor=(0.082, y), ncols=len(patches), borderaxespad=0.0,
            title="Background, what the gate said:", alignment="left", title_fontsize=8.5, handlelength=1.8,
            handleheight=1.0, columnspacing=1.8, labelcolor=FAINT, fontsize=8.5,
        )  # fmt: skip

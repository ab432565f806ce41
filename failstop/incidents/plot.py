"""Plot: an incident as one picture - the seconds around the stop on the left, its milliseconds on the right."""

from __future__ import annotations

from io import BytesIO
from textwrap import shorten
from typing import TYPE_CHECKING, Any

from failstop.incidents import file, outcome, panels, report, signals
from failstop.incidents.file import IncidentError
from failstop.incidents.incident import Event, Incident
from failstop.incidents.panels import ALARM, FAINT, GRID, INK, PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
NEEDS = "a plot needs matplotlib: pip install 'failstop[plots]'"
ZOOM_MS = (-60.0, 140.0)
"""A tick of 20 ms is to be seen, and the burst's repeats at 20 and 100 ms."""
LEAST_MS = 200.0
"""So much before the cause is in the picture, and after it, even of next to nothing."""
MOST_EVENTS = 12
EVENT_IN, HEAD_IN, FOOT_IN, PANEL_IN = 0.19, 1.28, 1.15, 0.84
"""Inches of the picture's height: a line of the events, what is above the panels and below, and one of height 1."""
LOWEST_IN = 0.2
"""The middle of the last event's line."""
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.parse_math": False,
    "text.color": INK,
    "axes.edgecolor": "#b8c0c8",
    "axes.labelcolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.linewidth": 1.7,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "hatch.linewidth": 0.6,
}


def save(incident: Incident, path: str, seconds: float) -> None:
    """Write the picture, from `seconds` before the cause to the end, whole or not at all. Raises IncidentError."""
    if not path.lower().endswith(FORMATS):
        raise IncidentError(f"{path}: a picture's name ends in {', '.join(FORMATS)}")
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    with rc_context(STYLE):
        figure = Figure(figsize=(13, 1), dpi=130, facecolor=PAPER)
        _draw(figure, incident, seconds)
        picture = BytesIO()
        figure.savefig(picture, format=path.rpartition(".")[2].lower())
    file.write_as(path, picture.getvalue())


def _draw(figure: Figure, incident: Incident, seconds: float) -> None:
    moved = any(joint.sent for joint in signals.joints(incident))
    shown = [panel for panel in panels.PANELS if panel is not panels.ARM or moved]
    events = _chosen(incident, seconds)
    heights = [height for _, height, _, _ in shown]
    events_in = EVENT_IN * len(events)
    height_in = HEAD_IN + FOOT_IN + PANEL_IN * sum(heights) + events_in
    figure.set_figheight(height_in)
    grid = {"height_ratios": heights, "width_ratios": (1.9, 1.0), "left": 0.09, "right": 0.975, "hspace": 0.28}
    grid |= {"wspace": 0.09, "top": 1 - HEAD_IN / height_in, "bottom": (FOOT_IN + events_in) / height_in}
    rows = figure.subplots(len(shown), 2, sharex="col", sharey="row", gridspec_kw=grid)
    begin_ms, end_ms = map(incident.ms, incident.span_ns())
    since_ms = max(min(begin_ms, -LEAST_MS), -seconds * 1e3)
    for (whole, zoom), (title, _, columns, draw) in zip(rows, shown, strict=True):
        whole.set_xlim(since_ms, max(end_ms, LEAST_MS))
        zoom.set_xlim(ZOOM_MS)
        draw((whole, zoom), incident)
        for axes, apart in ((whole, 0.03), (zoom, 0.045)):
            panels.background(axes, incident)
            _mark_events(axes, incident, events, apart, numbered=title == shown[0][0])
        whole.set_title(title, color=INK)
        if columns and whole.get_legend_handles_labels()[0]:
            whole.legend(
                loc="lower right", bbox_to_anchor=(1.0, 0.985), borderaxespad=0.0, ncols=columns, handlelength=1.4,
                columnspacing=1.2,
            )  # fmt: skip
    rows[0][1].set_title("Close up", color=FAINT)
    rows[-1][0].xaxis.set_major_formatter(lambda ms, _: f"{ms / 1e3:g}".replace("-", "\N{MINUS SIGN}"))
    rows[-1][0].set_xlabel("s from the cause")
    rows[-1][1].set_xlabel("ms from the cause")
    _title(figure, incident)
    _legend(figure, incident, since_ms, (FOOT_IN - 0.85 + LOWEST_IN + events_in) / height_in)
    _list_events(figure, incident, events)


def _title(figure: Figure, incident: Incident) -> None:
    head = incident.head
    proof = outcome.proof(report.known(incident), head)
    reason = shorten(incident.reason, 130) or "?"
    inch = 1 / figure.get_figheight()
    figure.text(0.03, 1 - 0.45 * inch, reason, fontsize=min(19, 1300 / len(reason)), fontweight="bold", color=ALARM)
    figure.text(0.03, 1 - 0.7 * inch, proof[0].upper() + proof[1:], fontsize=11)
    version = head["versions"]["failstop"]
    where = f"{report.when(head['t'])}   {head['host']}   service {head['name']}   failstop {version}"
    figure.text(0.03, 1 - 0.91 * inch, where, fontsize=9, color=FAINT)
    figure.text(0.975, 1 - 0.91 * inch, incident.id, fontsize=9, color=FAINT, ha="right")


def _legend(figure: Figure, incident: Incident, since_ms: float, y: float) -> None:
    """One row: what each shade means that is in the picture, its bottom at `y` of the figure."""
    from matplotlib.patches import Patch

    there = {what for what, _, end_ns in signals.gate_spans(incident) if incident.ms(end_ns) >= since_ms}
    patches = [Patch(label=words, **style) for what, (words, style) in panels.SHADES.items() if what in there]
    if patches:
        figure.legend(
            handles=patches, loc="lower left", bbox_to_anchor=(0.082, y), ncols=len(patches), borderaxespad=0.0,
            title="Background, what the gate said:", alignment="left", title_fontsize=8.5, handlelength=1.8,
            handleheight=1.0, columnspacing=1.8, labelcolor=FAINT, fontsize=8.5,
        )  # fmt: skip


def _chosen(incident: Incident, seconds: float) -> list[Event]:
    """The events that are in the picture, those near the cause first, in order."""
    found = [e for e in incident.events if incident.ms(e.ns) >= -seconds * 1e3 and e.kind != "incident"]
    nearest = sorted(found, key=lambda event: abs(event.ns - incident.cause_ns))[:MOST_EVENTS]
    return sorted(nearest, key=lambda event: event.ns)


def _mark_events(axes: Axes, incident: Incident, events: list[Event], apart: float, *, numbered: bool) -> None:
    """A thin line each, and above the uppermost panel its number; numbers that would cover each other share a place:
    those that are nearer than this share of the axis."""
    first, last = axes.get_xlim()
    places: list[tuple[float, list[int]]] = []
    for number, event in enumerate(events, 1):
        at = incident.ms(event.ns)
        if first <= at <= last:
            axes.axvline(at, color=FAINT, linewidth=0.7, alpha=0.5, zorder=1)
            if not places or at - places[-1][0] >= (last - first) * apart:
                places.append((at, []))
            places[-1][1].append(number)
    for at, numbers in places if numbered else []:
        label = f"{numbers[0]}-{numbers[-1]}" if len(numbers) > 1 else str(numbers[0])
        axes.annotate(
            label, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -2), textcoords="offset points",
            ha="center", va="top", fontsize=7.5, color=PAPER,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": FAINT, "edgecolor": "none"}, zorder=7,
        )  # fmt: skip


def _list_events(figure: Figure, incident: Incident, events: list[Event]) -> None:
    inch = 1 / figure.get_figheight()
    for number, event in enumerate(events, 1):
        y = (LOWEST_IN + EVENT_IN * (len(events) - number)) * inch
        color = ALARM if event.kind in ("stop", "died", "fenced") or event.level == "critical" else INK
        said = shorten(event.text.partition("; next: ")[0], 150)
        for x, words, ink, side in (
            (0.03, f"{number}", FAINT, "right"),
            (0.098, f"{incident.ms(event.ns):+.1f} ms", FAINT, "right"),
            (0.108, said, color, "left"),
        ):
            figure.text(x, y, words, fontsize=8.5, color=ink, ha=side, va="center")

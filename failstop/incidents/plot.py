"""Plot: an incident as one picture - the seconds around the stop on the left, its milliseconds on the right."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from math import nan
from textwrap import shorten
from typing import TYPE_CHECKING, Any

from failstop.incidents import report, signals
from failstop.incidents.file import IncidentError
from failstop.incidents.incident import Event, Incident
from failstop.shm import layout
from failstop.supervisor.settings import SettingError, Settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
NEEDS = "a plot needs matplotlib: pip install 'failstop[plots]'"
ZOOM_MS = (-60.0, 140.0)
"""A tick of 20 ms is to be seen, and the burst's repeats at 20 and 100 ms."""
MOST_EVENTS = 12
PANELS_IN = 9.6
EVENT_IN = 0.19
"""Inches of the picture's height: all but the events, and a line of these."""
HEAD_IN = 1.28
FOOT_IN = 0.72
HEIGHTS = (2.2, 1.9, 1.5, 2.9)
WIDTHS = (1.9, 1.0)

INK, FAINT, GRID, PAPER = "#1b1f24", "#6b7480", "#e3e7ec", "#ffffff"
ALARM = "#c62828"
BLUE, ORANGE, GREEN, PURPLE = "#0b6fb8", "#d9822b", "#1a936f", "#8e5ea2"
WHEELS = (
    (BLUE, 4.5, 0.3),
    (BLUE, 1.4, 1.0),
    (ORANGE, 4.5, 0.3),
    (ORANGE, 1.4, 1.0),
)
"""As signals.WHEELS: colour, width and opacity: the wheels of one side often turn alike, and both are to be seen."""
AXES = (("vx", BLUE), ("vy", ORANGE), ("wz", GREEN))
SHADES = {"estop": "#fdeaea", "disabled": "#f1f3f5", "cmd timeout": "#fff6df", "no scan": "#fff6df"}
"""Behind the curves while the gate blocks; white: the wheels may turn."""


def save(incident: Incident, path: str, seconds: float) -> None:
    """Write the picture, from `seconds` before the cause to the end. Raises IncidentError."""
    if not path.lower().endswith(FORMATS):
        raise IncidentError(f"{path}: a picture's name ends in {', '.join(FORMATS)}")
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        raise IncidentError(NEEDS) from None
    with rc_context(_STYLE):
        events = _chosen(incident, seconds)
        figure = Figure(figsize=(13, PANELS_IN + EVENT_IN * len(events)), dpi=130, facecolor=PAPER)
        _draw(figure, incident, seconds, events)
        try:
            figure.savefig(path)
        except OSError as error:
            raise IncidentError(f"{path} can't be written: {error.strerror}") from None


_STYLE: Any = {
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
}


class Panel:
    """One pair of axes: whole and zoomed. `per_ms` turns milliseconds from the cause into the axis's unit."""

    def __init__(self, axes: Axes, per_ms: float, first: float, last: float, *, zoomed: bool) -> None:
        self.axes = axes
        self.per_ms = per_ms
        self.zoomed = zoomed
        axes.set_xlim(first, last)

    def x(self, milliseconds: Any) -> Any:
        """Where on the axis."""
        return milliseconds * self.per_ms


def _draw(figure: Figure, incident: Incident, seconds: float, events: list[Event]) -> None:
    height_in = figure.get_figheight()
    grid = figure.add_gridspec(
        len(HEIGHTS), 2, height_ratios=HEIGHTS, width_ratios=WIDTHS, left=0.09, right=0.975, hspace=0.28, wspace=0.09
    )
    grid.update(top=1 - HEAD_IN / height_in, bottom=(FOOT_IN + EVENT_IN * len(events)) / height_in)
    end_ms = incident.ms(incident.span_ns()[1])
    drawers: tuple[Callable[[Panel, Incident], None], ...] = (_velocity, _wheels, _vibration, _lanes)
    for row, draw in enumerate(drawers):
        whole = figure.add_subplot(grid[row, 0])
        zoom = figure.add_subplot(grid[row, 1])
        for panel in (
            Panel(whole, 1e-3, -seconds, max(end_ms, 200.0) / 1e3, zoomed=False),
            Panel(zoom, 1.0, *ZOOM_MS, zoomed=True),
        ):
            _background(panel, incident)
            draw(panel, incident)
            _mark_events(panel, incident, events, numbered=row == 0)
            if row == 0:
                _name_shades(panel, incident)
            last = row == len(drawers) - 1
            panel.axes.tick_params(labelbottom=last)
            if last:
                panel.axes.set_xlabel("ms from the cause" if panel.zoomed else "s from the cause")
        zoom.set_ylim(whole.get_ylim())
        zoom.tick_params(labelleft=False)
    _title(figure, incident)
    _list_events(figure, incident, events)


def _title(figure: Figure, incident: Incident) -> None:
    head = incident.head
    inch = 1 / figure.get_figheight()
    figure.text(0.03, 1 - 0.45 * inch, shorten(incident.reason, 90), fontsize=19, fontweight="bold", color=ALARM)
    figure.text(0.03, 1 - 0.7 * inch, f"stop {report.proof(head['stop'])}", fontsize=11)
    where = (
        f"{report.when(head['t'])}   {head['host']}   service {head['name']}   failstop {head['versions']['failstop']}"
    )
    figure.text(0.03, 1 - 0.91 * inch, where, fontsize=9, color=FAINT)
    figure.text(0.975, 1 - 0.91 * inch, incident.id, fontsize=9, color=FAINT, ha="right")


def _background(panel: Panel, incident: Incident) -> None:
    """What the gate said, as shades, and the cause as a line."""
    for block, begin_ns, end_ns in _blocked(incident):
        begin, end = (panel.x(incident.ms(ns)) for ns in (begin_ns, end_ns))
        panel.axes.axvspan(begin, end, color=SHADES[block], linewidth=0, zorder=0)
    panel.axes.axvline(0, color=ALARM, linewidth=1.4, zorder=5)


def _blocked(incident: Incident) -> list[tuple[str, int, int]]:
    """Each time that the gate blocked: why, from when, until when."""
    found = []
    ticks = incident.ticks
    for block, run in groupby(enumerate(ticks), lambda numbered: numbered[1].block):
        numbers = [number for number, _ in run]
        if block in SHADES:
            after = ticks[min(numbers[-1] + 1, len(ticks) - 1)]
            found.append((block, ticks[numbers[0]].ns, after.ns))
    return found


def _name_shades(panel: Panel, incident: Incident) -> None:
    """Why the gate blocked, in the shade itself where that is wide enough."""
    first, last = panel.axes.get_xlim()
    for block, begin_ns, end_ns in _blocked(incident):
        begin, end = max(first, panel.x(incident.ms(begin_ns))), min(last, panel.x(incident.ms(end_ns)))
        if end - begin > (last - first) * 0.12:
            panel.axes.annotate(
                block, ((begin + end) / 2, 0), xycoords=("data", "axes fraction"), xytext=(0, 4),
                textcoords="offset points", ha="center", va="bottom", fontsize=8, color=FAINT, style="italic",
            )  # fmt: skip


def _velocity(panel: Panel, incident: Incident) -> None:
    axes, ticks = panel.axes, incident.ticks
    at = [panel.x(incident.ms(tick.ns)) for tick in ticks]
    limits = _limits(incident)
    for index, (name, color) in enumerate(AXES):
        unit = "rad/s" if name == "wz" else "m/s"
        gated = [tick.velocity[index] for tick in ticks]
        asked = [nan if tick.age_us is None else tick.command[index] for tick in ticks]
        if not (any(gated) or any(value == value and value for value in asked)):
            continue
        axes.plot(at, asked, color=color, alpha=0.45, linewidth=1.1, linestyle=(0, (3, 1.5)), drawstyle="steps-post")
        axes.plot(at, gated, color=color, drawstyle="steps-post", label=f"{name} ({unit})")
        if limit := limits.get(name):
            _limit(axes, limit, color)
            _limit(axes, -limit, color)
    axes.margins(y=0.15)
    if not panel.zoomed:
        axes.set_title("Velocity (dashed: commanded, dotted: limits)", color=INK)
        _legend(axes)


def _limit(axes: Axes, value: float, color: str) -> None:
    axes.axhline(value, color=color, linewidth=0.9, linestyle=":", alpha=0.7, zorder=1)


def _limits(incident: Incident) -> dict[str, float]:
    found = {}
    for axis, key in (("vx", "limits.vx_mps"), ("vy", "limits.vy_mps"), ("wz", "limits.wz_radps")):
        try:
            found[axis] = float(incident.settings[key])
        except (KeyError, ValueError):
            continue
    return found


def _wheels(panel: Panel, incident: Incident) -> None:
    """What was written to the board, not what was decided: the two differ where the port owner refused."""
    axes = panel.axes
    frames = [
        (write.ns, (0.0,) * 4 if signals.kind(write) == signals.STOP_BURST else signals.speeds_rps(write))
        for write in incident.writes
        if signals.kind(write) in (signals.MOTION, signals.ZERO, signals.STOP_BURST)
    ]
    # The board keeps the last speed until the next frame.
    frames += [(incident.span_ns()[1], frames[-1][1])] if frames else []
    at = [panel.x(incident.ms(ns)) for ns, _ in frames]
    for name, wire_id, (color, width, alpha) in zip(signals.WHEELS, signals.wheel_ids(incident), WHEELS, strict=True):
        axes.plot(
            at, [speeds[wire_id] for _, speeds in frames], color=color, drawstyle="steps-post", label=name, alpha=alpha,
            linewidth=width, solid_joinstyle="miter",
        )  # fmt: skip
    try:
        most = Settings.from_lines(
            "\n".join(f"{key}={value}" for key, value in incident.settings.items())
        ).max_wheel_rps()
    except (SettingError, ValueError):
        most = 0.0
    if most:
        _limit(axes, most, FAINT)
        _limit(axes, -most, FAINT)
    axes.margins(y=0.15)
    if not panel.zoomed:
        axes.set_title("Wheel speeds written to the board (rps)", color=INK)
        _legend(axes, columns=4)


def _vibration(panel: Panel, incident: Incident) -> None:
    axes = panel.axes
    at, values = signals.vibration(incident)
    limit = float(incident.settings.get("still.std_radps", "0.0035")) * 1e3
    values = values * 1e3
    axes.plot(panel.x(at), values, color=INK, linewidth=1.4)
    axes.fill_between(panel.x(at), values, limit, where=values > limit, color=ORANGE, alpha=0.3, linewidth=0)
    axes.axhline(limit, color=GREEN, linewidth=1.2, linestyle="--")
    axes.set_ylim(bottom=0, top=max([limit * 1.6, *(values * 1.15)]))
    if not panel.zoomed:
        axes.text(
            0.992, limit, f"still below {limit:g}", color=GREEN, fontsize=8, va="bottom", ha="right",
            transform=axes.get_yaxis_transform(), bbox={"facecolor": PAPER, "alpha": 0.7, "pad": 1, "linewidth": 0},
        )  # fmt: skip
        axes.set_title("Vibration: gyro std over 0.5 s (mrad/s); orange: the wheels turn", color=INK)


def _lanes(panel: Panel, incident: Incident) -> None:
    """One lane each for what came, what went out, and who beat."""
    axes = panel.axes
    by_kind: dict[str, list[float]] = {}
    for write in incident.writes:
        by_kind.setdefault(signals.kind(write), []).append(panel.x(incident.ms(write.ns)))
    rows: list[tuple[str, list[float], str, float]] = [
        ("commands", [panel.x(incident.ms(t.ns)) for t in incident.ticks if t.commands], BLUE, 0.9),
        ("motion frames", by_kind.get(signals.MOTION, []), INK, 0.9),
        ("zero frames", by_kind.get(signals.ZERO, []), FAINT, 0.9),
        ("stop bursts", by_kind.get(signals.STOP_BURST, []), ALARM, 2.2),
        ("pings", by_kind.get(signals.PING, []), PURPLE, 0.9),
        ("board heard", [panel.x(incident.ms(sample.ns)) for sample in incident.imu], GREEN, 0.6),
    ]
    names = [row[0] for row in rows] + [process.replace("_", " ") for process in layout.PROCESSES]
    for y, (_, times, color, width) in enumerate(rows):
        axes.vlines(times, y - 0.36, y + 0.36, color=color, linewidth=width)
    silent: dict[str, list[tuple[float, float]]] = {process: [] for process in layout.PROCESSES}
    for silence in signals.silences(incident):
        begin, end = (panel.x(incident.ms(ns)) for ns in (silence.since_ns, silence.until_ns))
        silent[silence.process].append((begin, end - begin))
    for y, process in enumerate(layout.PROCESSES, len(rows)):
        begin, end = _lifetime(incident, process)
        axes.broken_barh([(panel.x(begin), panel.x(end - begin))], (y - 0.22, 0.44), color="#a9d5c3", linewidth=0)
        axes.broken_barh(silent[process], (y - 0.32, 0.64), color=ALARM, linewidth=0)
        deaths = [
            incident.ms(event.ns)
            for event in incident.events
            if event.kind == "died" and event.fields.get("process") == process
        ]
        for death in deaths + ([end] if incident.head["kind"] == "left" else []):
            axes.plot(panel.x(death), y, marker="x", color=ALARM, markersize=6, markeredgewidth=1.8, clip_on=True)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    if not panel.zoomed:
        title = "Who was heard: a stroke each; green: a process beats, red: silent for too long; cross: it died"
        axes.set_title(title, color=INK)


def _lifetime(incident: Incident, process: str) -> tuple[float, float]:
    """From when to when a process beat, in ms from the cause, as far as is recorded."""
    begin_ns, end_ns = incident.span_ns()
    if incident.head["kind"] == "left":
        end_ns = max(begin_ns, min(end_ns, incident.words(process).get("beat_ns", end_ns)))
    return incident.ms(begin_ns), incident.ms(end_ns)


def _legend(axes: Axes, columns: int = 3) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.985), borderaxespad=0.0, ncols=columns, handlelength=1.4,
            columnspacing=1.2,
        )  # fmt: skip


def _chosen(incident: Incident, seconds: float) -> list[Event]:
    """The events that are in the picture, those near the cause first, in order."""
    since_ns = incident.cause_ns - round(seconds * 1e9)
    found = [event for event in incident.events if event.ns >= since_ns and event.kind != "incident"]
    nearest = sorted(found, key=lambda event: abs(event.ns - incident.cause_ns))[:MOST_EVENTS]
    return sorted(nearest, key=lambda event: event.ns)


def _mark_events(panel: Panel, incident: Incident, events: list[Event], *, numbered: bool) -> None:
    """A thin line each, and above the uppermost panel its number; numbers that would cover each other share a place."""
    first, last = panel.axes.get_xlim()
    places: list[tuple[float, list[int]]] = []
    for number, event in enumerate(events, 1):
        at = panel.x(incident.ms(event.ns))
        if not first <= at <= last:
            continue
        panel.axes.axvline(at, color=FAINT, linewidth=0.7, alpha=0.5, zorder=1)
        if places and at - places[-1][0] < (last - first) * (0.045 if panel.zoomed else 0.03):
            places[-1][1].append(number)
        else:
            places.append((at, [number]))
    for at, numbers in places if numbered else []:
        label = f"{numbers[0]}-{numbers[-1]}" if len(numbers) > 1 else str(numbers[0])
        panel.axes.annotate(
            label, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -2), textcoords="offset points",
            ha="center", va="top", fontsize=7.5, color=PAPER,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": FAINT, "edgecolor": "none"}, zorder=7,
        )  # fmt: skip


def _list_events(figure: Figure, incident: Incident, events: list[Event]) -> None:
    inch = 1 / figure.get_figheight()
    for number, event in enumerate(events, 1):
        y = (0.12 + EVENT_IN * (len(events) - number)) * inch
        color = ALARM if event.kind in ("stop", "died", "fenced") or event.level == "critical" else INK
        figure.text(0.03, y, f"{number}", fontsize=8.5, color=FAINT, ha="right", va="center")
        figure.text(0.098, y, f"{incident.ms(event.ns):+.1f} ms", fontsize=8.5, color=FAINT, ha="right", va="center")
        figure.text(0.108, y, shorten(event.text.partition("; next: ")[0], 150), fontsize=8.5, color=color, va="center")

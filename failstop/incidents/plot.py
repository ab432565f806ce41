"""Plot: an incident as one picture - the seconds around the stop on the left, its milliseconds on the right."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from math import inf, nan
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from failstop.incidents import file, report, shades, signals
from failstop.incidents.file import IncidentError
from failstop.incidents.incident import Event, Incident
from failstop.incidents.palette import ALARM, BEATS, BLUE, FAINT, GREEN, INK, ORANGE, PAPER, PURPLE, STYLE
from failstop.policy.settings import SettingError, Settings
from failstop.shm import layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
NEEDS = "a plot needs matplotlib: pip install 'failstop[plots]'"
ZOOM_MS = (-60.0, 140.0)
"""A tick of 20 ms is to be seen, and the burst's repeats at 20 and 100 ms."""
LEAST_NS = 200_000_000
"""So much before the cause is in the picture, and after it, even of next to nothing."""
MOST_EVENTS = 12
PANELS_IN = 9.6
EVENT_IN = 0.19
"""Inches of the picture's height: all but the events, and a line of these."""
HEAD_IN = 1.28
FOOT_IN = 1.15
LOWEST_IN = 0.2
"""The middle of the last event's line."""
HEIGHTS = (2.2, 1.9, 1.5, 2.9)
WIDTHS = (1.9, 1.0)
ARM_HEIGHT = 1.9
ARM_IN = 2.0
"""What the arm's panel adds, where it was moved."""
JOINTS = (BLUE, ORANGE, GREEN, PURPLE, INK, ALARM, FAINT, BLUE)

WHEELS = (
    (BLUE, 4.5, 0.3),
    (BLUE, 1.4, 1.0),
    (ORANGE, 4.5, 0.3),
    (ORANGE, 1.4, 1.0),
)
"""As signals.WHEELS: colour, width and opacity: the wheels of one side often turn alike, and both are to be seen."""
Row = tuple[int, tuple[float, float, float], tuple[float, float, float]]
NOTHING = (nan, nan, nan)
AXES = (("vx", BLUE), ("vy", ORANGE), ("wz", GREEN))


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
        events = _chosen(incident, seconds)
        arm_in = ARM_IN if signals.joint_tracks(incident) else 0.0
        figure = Figure(figsize=(13, PANELS_IN + arm_in + EVENT_IN * len(events)), dpi=130, facecolor=PAPER)
        _draw(figure, incident, seconds, events)
        picture = BytesIO()
        figure.savefig(picture, format=path.rpartition(".")[2].lower())
    file.write_as(path, picture.getvalue())


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
    drawers: tuple[Callable[[Panel, Incident], None], ...] = (_velocity, _wheels, _vibration, _lanes)
    heights: tuple[float, ...] = HEIGHTS
    if signals.joint_tracks(incident):
        drawers, heights = (*drawers[:2], _joints, *drawers[2:]), (*HEIGHTS[:2], ARM_HEIGHT, *HEIGHTS[2:])
    grid = figure.add_gridspec(
        len(heights), 2, height_ratios=heights, width_ratios=WIDTHS, left=0.09, right=0.975, hspace=0.28, wspace=0.09
    )
    grid.update(top=1 - HEAD_IN / height_in, bottom=(FOOT_IN + EVENT_IN * len(events)) / height_in)
    begin_ns, end_ns = incident.span_ns()
    end_ms = incident.ms(end_ns)
    since_ns = max(min(begin_ns, incident.cause_ns - LEAST_NS), incident.cause_ns - round(seconds * 1e9))
    for row, draw in enumerate(drawers):
        whole = figure.add_subplot(grid[row, 0])
        zoom = figure.add_subplot(grid[row, 1])
        for panel in (
            Panel(whole, 1e-3, incident.ms(since_ns) / 1e3, max(end_ms, 200.0) / 1e3, zoomed=False),
            Panel(zoom, 1.0, *ZOOM_MS, zoomed=True),
        ):
            _background(panel, incident)
            draw(panel, incident)
            _mark_events(panel, incident, events, numbered=row == 0)
            last = row == len(drawers) - 1
            panel.axes.tick_params(labelbottom=last)
            if last:
                panel.axes.set_xlabel("ms from the cause" if panel.zoomed else "s from the cause")
        zoom.set_ylim(whole.get_ylim())
        if row == 0:
            zoom.set_title("Close up", color=FAINT)
        zoom.tick_params(labelleft=False)
    _title(figure, incident)
    shades.legend(figure, incident, since_ns, (FOOT_IN - 0.85 + LOWEST_IN + EVENT_IN * len(events)) / height_in)
    _list_events(figure, incident, events)


def _title(figure: Figure, incident: Incident) -> None:
    head = incident.head
    proof = report.proof(report.known(incident), head)
    reason = shorten(incident.reason, 130) or "?"
    inch = 1 / figure.get_figheight()
    figure.text(0.03, 1 - 0.45 * inch, reason, fontsize=min(19, 1300 / len(reason)), fontweight="bold", color=ALARM)
    figure.text(0.03, 1 - 0.7 * inch, proof[0].upper() + proof[1:], fontsize=11)
    where = (
        f"{report.when(head['t'])}   {head['host']}   service {head['name']}   failstop {head['versions']['failstop']}"
    )
    figure.text(0.03, 1 - 0.91 * inch, where, fontsize=9, color=FAINT)
    figure.text(0.975, 1 - 0.91 * inch, incident.id, fontsize=9, color=FAINT, ha="right")


def _background(panel: Panel, incident: Incident) -> None:
    """What the gate said, as shades, and the cause as a line."""
    shades.draw(panel.axes, incident, panel.per_ms)
    panel.axes.axvline(0, color=ALARM, linewidth=1.4, zorder=5)


def _velocity(panel: Panel, incident: Incident) -> None:
    """What was commanded and what the gate made of it; nothing where the gate was silent."""
    axes = panel.axes
    limits = _limits(incident)
    silent = [(begin_ns, end_ns) for what, begin_ns, end_ns in shades.spans(incident) if what == shades.SILENT]
    holds_us = _holds_us(incident)
    rows: list[Row] = []
    for tick in incident.ticks:
        holds = tick.age_us is not None and tick.age_us <= holds_us
        rows.append((tick.ns, tick.command if holds else NOTHING, tick.velocity))
    rows += [(begin_ns + 1, NOTHING, NOTHING) for begin_ns, _ in silent]
    rows.sort(key=lambda row: row[0])
    at = [panel.x(incident.ms(ns)) for ns, _, _ in rows]
    shown: list[float] = []
    lines: list[tuple[float, str, str]] = []
    for index, (name, color) in enumerate(AXES):
        unit = "rad/s" if name == "wz" else "m/s"
        limit = limits.get(name, inf)
        asked, gated = [row[1][index] for row in rows], [row[2][index] for row in rows]
        moved = [value for value in (*asked, *gated) if value and value == value]
        if not moved:
            continue
        axes.plot(at, asked, color=color, alpha=0.45, linewidth=1.1, linestyle=(0, (3, 1.5)), drawstyle="steps-post")
        axes.plot(at, gated, color=color, drawstyle="steps-post", label=f"{name} ({unit})")
        # A command far beyond its limit must not squash what the wheels did.
        shown += [max(-limit * 1.3, min(limit * 1.3, value)) for value in moved]
        lines += [(sign * limit, f"limit {sign * limit:g} {unit}", color) for sign in (1, -1) if limit < inf]
    _scale(axes, shown, lines, least=0.1)
    if not panel.zoomed:
        axes.set_title("Velocity (dashed: commanded)", color=INK)
        _legend(axes)


def _holds_us(incident: Incident) -> float:
    """How long a command may hold, whoever sends it."""
    times = [
        float(value)
        for key, value in incident.settings.items()
        if key == "gate.command_timeout_s" or (key.startswith("sources.") and key.endswith(".timeout_s"))
    ]
    return max(times, default=0.3) * 1e6


def _scale(axes: Axes, shown: list[float], limits: list[tuple[float, str, str]], least: float) -> None:
    """Limits of the y axis: by the values, and by those limits (value, words, colour) that are not far off."""
    high = max([least, *(value for value in shown if abs(value) < inf)])
    low = min([0.0, *(value for value in shown if abs(value) < inf)])
    near = [limit for limit in limits if low * 2 <= limit[0] <= high * 2]
    values = [high, low, *(value for value, _, _ in near)]
    margin = (max(values) - min(values)) * 0.16
    # Above the curves is the place of the events' numbers.
    axes.set_ylim(min(values) - margin, max(values) + margin * 1.6)
    for value, words, color in near:
        axes.axhline(value, color=color, linewidth=0.9, linestyle=":", alpha=0.8, zorder=1)
        axes.annotate(
            words, (0, value), xycoords=("axes fraction", "data"), xytext=(4, 2), textcoords="offset points",
            fontsize=7.5, color=color, annotation_clip=True,
        )  # fmt: skip


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
    most = _most_rps(incident)
    values = [speed for _, speeds in frames for speed in speeds]
    _scale(axes, values, [(sign * most, f"limit {sign * most:.2f}", FAINT) for sign in (1, -1) if most], least=0.2)
    if not panel.zoomed:
        axes.set_title("Wheel speeds written to the board (rps)", color=INK)
        _legend(axes, columns=4)


def _joints(panel: Panel, incident: Incident) -> None:
    """Where each joint was sent, a line: a servo gets there within its move, of some 40 ms, and stands at a stop burst.
    Where it was to be in the end, dots; where it was read to be, crosses: while it moves no servo is asked."""
    axes = panel.axes
    names = signals.joint_names(incident)
    goals, readings = signals.joint_goals(incident), signals.joint_readings(incident)
    for (servo, track), color in zip(sorted(signals.joint_tracks(incident).items()), JOINTS, strict=False):
        at, pulses = (np.array(column, dtype=float) for column in zip(*track, strict=True))
        at, pulses = signals.broken((at - incident.cause_ns) / 1e6, pulses)
        axes.plot(panel.x(at), pulses, color=color, label=f"{names.get(servo, 'servo')} ({servo})")
        for points, marker, size in ((goals.get(servo), ".", 2.0), (readings.get(servo), "x", 4.0)):
            if points:
                at, pulses = (np.array(column, dtype=float) for column in zip(*points, strict=True))
                axes.plot(
                    *(panel.x((at - incident.cause_ns) / 1e6), pulses),
                    color=color,
                    linestyle="none",
                    marker=marker,
                    markersize=size,
                )
    if not panel.zoomed:
        axes.set_title(
            "The arm's joints: sent (lines), goals (dots), read (crosses); pulses of 0.24 degrees", color=INK
        )
        _legend(axes, columns=6)


def _most_rps(incident: Incident) -> float:
    """What the port owner lets through; 0: not known."""
    lines = "\n".join(f"{key}={value}" for key, value in incident.settings.items())
    try:
        return Settings.from_lines(lines).max_wheel_rps()
    except (SettingError, ValueError):
        return 0.0


def _vibration(panel: Panel, incident: Incident) -> None:
    axes = panel.axes
    at, values = signals.broken(*signals.vibration(incident))
    limit = float(incident.settings.get("still.std_radps", "0.0035")) * 1e3
    values = values * 1e3
    axes.plot(panel.x(at), values, color=INK, linewidth=1.4)
    axes.fill_between(panel.x(at), values, limit, where=values > limit, color=ORANGE, alpha=0.3, linewidth=0)
    axes.axhline(limit, color=GREEN, linewidth=1.2, linestyle="--")
    axes.set_ylim(bottom=0, top=max([limit * 1.6, *(value * 1.15 for value in values if value == value)]))
    if not panel.zoomed:
        axes.text(
            0.006, limit, f"still below {limit:g}", color=GREEN, fontsize=8, va="bottom", ha="left",
            transform=axes.get_yaxis_transform(),
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
        axes.broken_barh([(panel.x(begin), panel.x(end - begin))], (y - 0.22, 0.44), color=BEATS, linewidth=0)
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
        y = (LOWEST_IN + EVENT_IN * (len(events) - number)) * inch
        color = ALARM if event.kind in ("stop", "died", "fenced") or event.level == "critical" else INK
        figure.text(0.03, y, f"{number}", fontsize=8.5, color=FAINT, ha="right", va="center")
        figure.text(0.098, y, f"{incident.ms(event.ns):+.1f} ms", fontsize=8.5, color=FAINT, ha="right", va="center")
        figure.text(0.108, y, shorten(event.text.partition("; next: ")[0], 150), fontsize=8.5, color=color, va="center")

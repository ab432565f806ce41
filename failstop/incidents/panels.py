"""Panels: an incident's curves, one pair of axes each - the seconds around the stop, and its milliseconds. What is on
the time axis is in ms from the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from failstop.incidents import signals
from failstop.incidents.incident import MOTION, PING, STOP_BURST, ZERO, Incident
from failstop.incidents.signals import DRIVING, SILENT
from failstop.policy import kinematics
from failstop.policy.settings import SettingError, Settings
from failstop.shm import blocks, layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    Pair = tuple[Axes, Axes]
    Panel = tuple[str, float, int, Callable[[Pair, Incident], None]]

INK, FAINT, GRID, PAPER = "#1b1f24", "#6b7480", "#e3e7ec", "#ffffff"
ALARM, BEATS = "#c62828", "#a9d5c3"
BLUE, ORANGE, GREEN, PURPLE = "#0b6fb8", "#d9822b", "#1a936f", "#8e5ea2"

AXES = (
    ("vx", "m/s", "limits.vx_mps", BLUE),
    ("vy", "m/s", "limits.vy_mps", ORANGE),
    ("wz", "rad/s", "limits.wz_radps", GREEN),
)
WHEELS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linewidth": 4.5, "alpha": 0.3},
    {"color": BLUE, "linewidth": 1.4},
    {"color": ORANGE, "linewidth": 4.5, "alpha": 0.3},
    {"color": ORANGE, "linewidth": 1.4},
)
"""As signals.WHEELS: the wheels of one side often turn alike, and both are to be seen."""
WRITTEN = (
    ("motion frames", MOTION, INK, 0.9),
    ("zero frames", ZERO, FAINT, 0.9),
    ("stop bursts", STOP_BURST, ALARM, 2.2),
    ("pings", PING, PURPLE, 0.9),
)
"""The lanes of what was written: name, sort, colour and width of a stroke."""
JOINTS = (BLUE, ORANGE, GREEN, PURPLE, INK, ALARM, FAINT, BLUE)
NOTHING = (nan, nan, nan)
SHADES: dict[str, tuple[str, dict[str, Any]]] = {
    DRIVING: ("the wheels may turn", {"facecolor": PAPER, "edgecolor": GRID}),
    "estop": ("a stop is latched", {"facecolor": "#fdeaea", "linewidth": 0}),
    blocks.DISABLED: ("motion is disabled", {"facecolor": "#eceff3", "linewidth": 0}),
    blocks.NO_COMMAND: ("no command", {"facecolor": "#fff3d1", "linewidth": 0}),
    blocks.NO_SCAN: ("no obstacle sensor", {"facecolor": "#e3effa", "linewidth": 0}),
    SILENT: ("the gate is silent", {"facecolor": "#eef0f3", "edgecolor": "#d3d9df", "hatch": "////", "linewidth": 0}),
}
"""By what the gate says: words for the legend, and how it is drawn behind the curves."""


def background(axes: Axes, incident: Incident) -> None:
    """What the gate said, as shades, and the cause as a line."""
    for what, begin_ns, end_ns in signals.gate_spans(incident):
        if what != DRIVING and what in SHADES:
            axes.axvspan(incident.ms(begin_ns), incident.ms(end_ns), zorder=0, **SHADES[what][1])
    axes.axvline(0, color=ALARM, linewidth=1.4, zorder=5)


def _times(incident: Incident, times_ns: Iterable[int]) -> list[float]:
    return [incident.ms(ns) for ns in times_ns]


def _velocity(pair: Pair, incident: Incident) -> None:
    """What was commanded and what the gate made of it; nothing where the gate was silent."""
    timeouts = [
        incident.number(key, 0.0)
        for key in incident.settings
        if key == "gate.command_timeout_s" or (key.startswith("sources.") and key.endswith(".timeout_s"))
    ]
    holds_us = max(timeouts, default=0.3) * 1e6
    rows = [
        (tick.ns, tick.command if tick.age_us is not None and tick.age_us <= holds_us else NOTHING, tick.velocity)
        for tick in incident.ticks
    ]
    silent = [begin_ns for what, begin_ns, _ in signals.gate_spans(incident) if what == SILENT]
    rows = sorted([*rows, *((begin_ns + 1, NOTHING, NOTHING) for begin_ns in silent)], key=lambda row: row[0])
    at = _times(incident, (ns for ns, _, _ in rows))
    shown: list[float] = []
    lines: list[tuple[float, str, str]] = []
    for index, (name, unit, key, color) in enumerate(AXES):
        asked, gated = [row[1][index] for row in rows], [row[2][index] for row in rows]
        moved = [value for value in (*asked, *gated) if value and value == value]
        if not moved:
            continue
        for axes in pair:
            axes.step(at, asked, where="post", color=color, alpha=0.45, linewidth=1.1, linestyle=(0, (3, 1.5)))
            axes.step(at, gated, where="post", color=color, label=f"{name} ({unit})")
        # A command far beyond its limit must not squash what the wheels did.
        limit = incident.number(key, inf)
        shown += [max(-limit * 1.3, min(limit * 1.3, value)) for value in moved]
        lines += [(sign * limit, f"limit {sign * limit:g} {unit}", color) for sign in (1, -1) if limit < inf]
    _scale(pair, shown, lines, least=0.1)


def _scale(pair: Pair, shown: list[float], limits: list[tuple[float, str, str]], least: float) -> None:
    """Limits of the y axis: by the values, and by those limits (value, words, colour) that are not far off."""
    high = max([least, *filter(isfinite, shown)])
    low = min([0.0, *filter(isfinite, shown)])
    near = [limit for limit in limits if low * 2 <= limit[0] <= high * 2]
    values = [high, low, *(value for value, _, _ in near)]
    margin = (max(values) - min(values)) * 0.16
    # Above the curves is the place of the events' numbers.
    pair[0].set_ylim(min(values) - margin, max(values) + margin * 1.6)
    for axes in pair:
        for value, words, color in near:
            axes.axhline(value, color=color, linewidth=0.9, linestyle=":", alpha=0.8, zorder=1)
            _label(axes, value, words, color)


def _label(axes: Axes, value: float, words: str, color: str) -> None:
    """Of a level, at its left end."""
    axes.annotate(
        words, (0, value), xycoords=("axes fraction", "data"), xytext=(4, 2), textcoords="offset points",
        fontsize=7.5, color=color, annotation_clip=True,
    )  # fmt: skip


def _wheels(pair: Pair, incident: Incident) -> None:
    """What was written to the board, not what was decided: the two differ where the port owner refused."""
    frames = [(write.ns, write.speeds_rps) for write in incident.writes if write.speeds_rps is not None]
    # The board keeps the last speed until the next frame.
    frames += [(incident.span_ns()[1], frames[-1][1])] if frames else []
    at = _times(incident, (ns for ns, _ in frames))
    for name, wire_id, style in zip(signals.WHEELS, signals.wheel_ids(incident), WHEELS, strict=True):
        for axes in pair:
            speeds = [speeds[wire_id] for _, speeds in frames]
            axes.step(at, speeds, where="post", label=name, solid_joinstyle="miter", **style)
    most = _most_rps(incident)
    values = [speed for _, speeds in frames for speed in speeds]
    _scale(pair, values, [(sign * most, f"limit {sign * most:.2f}", FAINT) for sign in (1, -1) if most], least=0.2)


def _most_rps(incident: Incident) -> float:
    """What the port owner lets through; 0: not known."""
    try:
        lines = "\n".join(f"{key}={value}" for key, value in incident.settings.items())
        return kinematics.max_wheel_rps(Settings.from_lines(lines))
    except (SettingError, ValueError):
        return 0.0


def _joints(pair: Pair, incident: Incident) -> None:
    """Where each joint was sent, a line: a servo gets there within its move, of some 40 ms, and stands at a stop burst.
    Where it was to be in the end, dots; where it was read to be, crosses: while it moves no servo is asked."""
    sent = [joint for joint in signals.joints(incident) if joint.sent]
    for joint, color in zip(sent, JOINTS, strict=False):
        line = signals.broken(*signals.columns(incident, joint.sent))
        goals, read = (signals.columns(incident, points) for points in (joint.goals, joint.read))
        for axes in pair:
            axes.plot(*line, color=color, label=f"{joint.name or 'servo'} ({joint.servo})")
            axes.plot(*goals, color=color, linestyle="none", marker=".", markersize=2)
            axes.plot(*read, color=color, linestyle="none", marker="x", markersize=4)


def _vibration(pair: Pair, incident: Incident) -> None:
    at, values = signals.broken(*signals.vibration(incident))
    limit = signals.still_radps(incident) * 1e3
    values = values * 1e3
    for axes in pair:
        axes.plot(at, values, color=INK, linewidth=1.4)
        axes.fill_between(at, values, limit, where=values > limit, color=ORANGE, alpha=0.3, linewidth=0)
        axes.axhline(limit, color=GREEN, linewidth=1.2, linestyle="--")
    pair[0].set_ylim(0, max([limit * 1.6, *(values[np.isfinite(values)] * 1.15)]))
    _label(pair[0], limit, f"still below {limit:g}", GREEN)


def _lanes(pair: Pair, incident: Incident) -> None:
    """One lane each for what came, what went out, and who beat."""
    strokes = [
        ("commands", _times(incident, (tick.ns for tick in incident.ticks if tick.commands)), BLUE, 0.9),
        *(
            (name, _times(incident, (write.ns for write in incident.writes if write.sort == sort)), color, width)
            for name, sort, color, width in WRITTEN
        ),
        ("board heard", _times(incident, (sample.ns for sample in incident.imu)), GREEN, 0.6),
    ]
    names, times, colors, widths = (list(column) for column in zip(*strokes, strict=True))
    names += [process.replace("_", " ") for process in layout.PROCESSES]
    silences = signals.silences(incident)
    for axes in pair:
        axes.eventplot(times, lineoffsets=range(len(times)), linelengths=0.72, linewidths=widths, colors=colors)
        for y, process in enumerate(layout.PROCESSES, len(times)):
            begin, end = _lifetime(incident, process)
            axes.broken_barh([(begin, end - begin)], (y - 0.22, 0.44), color=BEATS, linewidth=0)
            silent = [
                (incident.ms(silence.since_ns), (silence.until_ns - silence.since_ns) / 1e6)
                for silence in silences
                if silence.process == process
            ]
            axes.broken_barh(silent, (y - 0.32, 0.64), color=ALARM, linewidth=0)
            deaths = _times(incident, signals.deaths(incident, process)) + [end] * (incident.head["kind"] == "left")
            axes.plot(deaths, [y] * len(deaths), "x", color=ALARM, markersize=6, markeredgewidth=1.8)
    pair[0].set_yticks(range(len(names)), names)
    pair[0].set_ylim(len(names) - 0.4, -0.6)
    for axes in pair:
        axes.grid(axis="y", visible=False)


def _lifetime(incident: Incident, process: str) -> tuple[float, float]:
    """From when to when a process beat, in ms from the cause, as far as is recorded."""
    begin_ns, end_ns = incident.span_ns()
    if incident.head["kind"] == "left":
        end_ns = max(begin_ns, min(end_ns, incident.words(process).get("beat_ns", end_ns)))
    return incident.ms(begin_ns), incident.ms(end_ns)


ARM: Panel = ("The arm: sent (lines), goals (dots), read (crosses); pulses of 0.24 degrees", 1.9, 6, _joints)
"""Only where it was moved."""
PANELS: tuple[Panel, ...] = (
    ("Velocity (dashed: commanded)", 2.2, 3, _velocity),
    ("Wheel speeds written to the board (rps)", 1.9, 4, _wheels),
    ARM,
    ("Vibration: gyro std over 0.5 s (mrad/s); orange: the wheels turn", 1.5, 0, _vibration),
    ("Who was heard: a stroke each; green: a process beats, red: silent for too long; cross: it died", 2.9, 0, _lanes),
)
"""From the top: title, height, columns of its legend, and what draws it."""

"""Plot: an incident as one picture - the seconds around the stop on the left, its milliseconds on the right. What is on
the time axis is in ms from the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from io import BytesIO
from math import nan
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from failstop.api.events import Event
from failstop.incidents import files, memory, report
from failstop.incidents.files import IncidentError
from failstop.incidents.incident import DRIVING, SAYS, SILENT, WHEELS, Incident, Sort
from failstop.procs.telemetry.still import LEAST_SAMPLES, WINDOW_NS
from failstop.shm import blocks, layout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Array = npt.NDArray[np.float64]
Panel = tuple[str, float, Callable[["Axes", Incident], None]]

FORMATS = (".png", ".svg", ".pdf")
NEEDS = "a plot needs matplotlib: pip install 'failstop[plots]'"
ZOOM_MS = (-60.0, 140.0)
"""A tick of 20 ms is to be seen, and the burst's repeats at 20 and 100 ms."""
LEAST_MS = 200.0
"""So much before the cause is in the picture, and after it, even of next to nothing."""
BREAK_MS = 100.0
"""A board that sends 110 samples a second and none for so long was silent: no line is drawn across."""
MOST_EVENTS = 12
EVENT_IN = 0.19
"""Height of a line of the events."""
INK, FAINT, ALARM, BEATS = "#1b1f24", "#6b7480", "#c62828", "#a9d5c3"
STYLE: Any = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.ymargin": 0.16,
    "figure.constrained_layout.w_pad": 0.15,
    "font.size": 9,
    "grid.color": "#e3e7ec",
    "hatch.linewidth": 0.6,
    "legend.fontsize": 8,
    "text.parse_math": False,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
}
AXES = (("vx", "m/s", "limits.vx_mps"), ("vy", "m/s", "limits.vy_mps"), ("wz", "rad/s", "limits.wz_radps"))
WRITTEN = {Sort.MOTION: ("motion frames", INK), Sort.ZERO: ("zero frames", FAINT)}
WRITTEN |= {Sort.STOP_BURST: ("stop bursts", ALARM), Sort.PING: ("pings", "C3")}
"""The lanes of what was written, by its sort: name, colour."""
SHADES: dict[str, dict[str, Any]] = {
    DRIVING: {"facecolor": "white", "edgecolor": "#e3e7ec"},
    "estop": {"facecolor": "#fdeaea"},
    blocks.DISABLED: {"facecolor": "#eceff3"},
    blocks.NO_COMMAND: {"facecolor": "#fff3d1"},
    blocks.NO_SCAN: {"facecolor": "#e3effa"},
    SILENT: {"facecolor": "#eef0f3", "edgecolor": "#d3d9df", "hatch": "////"},
}
"""How each word of the gate's is drawn behind the curves."""


def save(incident: Incident, path: str, seconds: float) -> None:
    """Write the picture, from `seconds` before the cause to the end, whole or not at all. Raises IncidentError."""
    if not path.lower().endswith(FORMATS):
        raise IncidentError(f"{path}: a picture's name ends in {', '.join(FORMATS)}")
    try:
        from matplotlib import style
        from matplotlib.figure import Figure
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    with style.context(["seaborn-v0_8-whitegrid", "seaborn-v0_8-colorblind", STYLE]):
        figure = Figure(dpi=130, facecolor="white", layout="constrained")
        _draw(figure, incident, seconds)
        picture = BytesIO()
        figure.savefig(picture, format=path.rpartition(".")[2].lower())
    files.write_as(path, picture.getvalue())


def _draw(figure: Figure, incident: Incident, seconds: float) -> None:
    """From the top: what happened, the panels, what their background means, the events."""
    moved = any(joint.sent for joint in incident.joints())
    shown = [panel for panel in PANELS if moved or panel[2] is not _joints]
    found = [e for e in incident.events if incident.ms(e.ns) >= -seconds * 1e3 and e.kind != "incident"]
    nearest = sorted(found, key=lambda event: abs(event.ns - incident.cause_ns))[:MOST_EVENTS]
    events = sorted(nearest, key=lambda event: event.ns)
    heights = [height for _, height, _ in shown]
    inches = (0.95, sum(heights) + 0.4, 0.6 + EVENT_IN * len(events))
    figure.set_size_inches(13, sum(inches))
    parts: Any = figure.subfigures(3, 1, height_ratios=inches)
    head, middle, foot = parts
    ratios = {"height_ratios": heights, "width_ratios": (1.9, 1.0)}
    rows = middle.subplots(len(shown), 2, sharex="col", sharey="row", gridspec_kw=ratios)
    begin_ms, end_ms = map(incident.ms, incident.span_ns)
    rows[0][0].set_xlim(max(min(begin_ms, -LEAST_MS), -seconds * 1e3), max(end_ms, LEAST_MS))
    rows[0][1].set_xlim(ZOOM_MS)
    for (title, _, draw), (whole, zoom) in zip(shown, rows, strict=True):
        for axes in (whole, zoom):
            draw(axes, incident)
            for what, begin_ns, end_ns in incident.gate_spans():
                if what != DRIVING and what in SHADES:
                    axes.axvspan(incident.ms(begin_ns), incident.ms(end_ns), zorder=0, linewidth=0, **SHADES[what])
            axes.axvline(0, color=ALARM, linewidth=1.4, zorder=5)
            for event in events:
                axes.axvline(incident.ms(event.ns), color=FAINT, linewidth=0.7, alpha=0.5, zorder=1)
        whole.set_title(title, color=INK)
        if handles := whole.get_legend_handles_labels()[0]:
            place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.985), "borderaxespad": 0.0}
            whole.legend(handles=handles, ncols=min(len(handles), 6), handlelength=1.4, columnspacing=1.2, **place)
    rows[0][1].set_title("Close up", color=FAINT)
    rows[-1][0].xaxis.set_major_formatter(lambda ms, _: f"{ms / 1e3:g}".replace("-", "\N{MINUS SIGN}"))
    rows[-1][0].set_xlabel("s from the cause")
    rows[-1][1].set_xlabel("ms from the cause")
    _title(head, incident)
    _foot(foot, incident, events)


def _title(figure: SubFigure, incident: Incident) -> None:
    head = incident.head
    proof = memory.proof(incident.proven(), head)
    reason = shorten(incident.reason, 130) or "?"
    figure.text(0.03, 0.55, reason, fontsize=min(19, 1300 / len(reason)), fontweight="bold", color=ALARM)
    figure.text(0.03, 0.28, proof[0].upper() + proof[1:], fontsize=11)
    version = head["versions"]["failstop"]
    where = f"{report.when(head['t'])}   {head['host']}   service {head['name']}   failstop {version}"
    figure.text(0.03, 0.06, where, color=FAINT)
    figure.text(0.975, 0.06, incident.id, color=FAINT, ha="right")


def _foot(figure: SubFigure, incident: Incident, events: list[Event]) -> None:
    """What each shade means that is in the picture, and the events, a line each."""
    from matplotlib.patches import Patch

    there = {what for what, _, _ in incident.gate_spans()}
    patches = [Patch(label=SAYS[what], **SHADES[what]) for what in SHADES if what in there]
    if patches:
        said = {"title": "Background, what the gate said:", "alignment": "left", "labelcolor": FAINT}
        figure.legend(handles=patches, loc="upper left", bbox_to_anchor=(0.07, 1.0), ncols=len(patches), **said)
    lines = [f"{incident.ms(e.ns):+9.1f} ms  {shorten(e.text.partition('; next: ')[0], 150)}" for e in events]
    figure.text(0.03, 0.0, "\n".join(lines), family="monospace", linespacing=1.5, va="bottom")


def _at(incident: Incident, entries: Iterable[tuple[Any, ...]]) -> list[float]:
    """When they were."""
    return [incident.ms(entry[0]) for entry in entries]


def _velocity(axes: Axes, incident: Incident) -> None:
    """What was commanded and what the gate made of it; nothing where the gate was silent. A command far beyond its
    limit must not squash what the wheels did."""
    fresh_us = incident.number("gate.command_timeout_s") * 1e6
    nothing = (nan, nan, nan)
    rows = [
        (tick.ns, tick.command if tick.age_us is not None and tick.age_us <= fresh_us else nothing, tick.velocity)
        for tick in incident.ticks
    ]
    rows += [(ns + 1, nothing, nothing) for what, ns, _ in incident.gate_spans() if what == SILENT]
    rows.sort(key=lambda row: row[0])
    for index, (name, unit, limit) in enumerate(AXES):
        most, color = incident.number(limit) * 1.3, f"C{index}"
        asked = np.clip([command[index] for _, command, _ in rows], -most, most)
        gated = np.clip([velocity[index] for _, _, velocity in rows], -most, most)
        if np.nan_to_num([asked, gated]).any():
            axes.step(_at(incident, rows), asked, where="post", color=color, linewidth=1.1, linestyle="--", alpha=0.5)
            axes.step(_at(incident, rows), gated, where="post", color=color, label=f"{name} ({unit})")


def _wheels(axes: Axes, incident: Incident) -> None:
    """What was written to the board, not what was decided: the two differ where the port owner refused. The wheels of
    one side often turn alike, and both are to be seen."""
    frames = [(write.ns, write.speeds_rps) for write in incident.writes if write.speeds_rps]
    # The board keeps the last speed until the next frame.
    frames += [(incident.span_ns[1], frames[-1][1])] if frames else []
    for index, name in enumerate(WHEELS):
        line: dict[str, Any] = {"linewidth": 1.4} if index % 2 else {"linewidth": 4.5, "alpha": 0.3}
        speeds_rps = [speeds[index] for _, speeds in frames]
        axes.step(_at(incident, frames), speeds_rps, where="post", label=name, color=f"C{index // 2}", **line)


def _joints(axes: Axes, incident: Incident) -> None:
    """Where each joint was sent, a line: a servo gets there within its move, of some 40 ms, and stands at a stop burst.
    Where it was to be in the end, dots; where it was read to be, crosses: while it moves no servo is asked."""
    for index, joint in enumerate(joint for joint in incident.joints() if joint.sent):
        sent = np.array(_at(incident, joint.sent)), np.array([float(pulses) for _, pulses in joint.sent])
        axes.plot(*broken(*sent), color=f"C{index}", label=f"{joint.name or 'servo'} ({joint.servo})")
        for points, marker in ((joint.goals, "."), (joint.read, "x")):
            axes.plot(_at(incident, points), [pulses for _, pulses in points], f"C{index}{marker}", markersize=4)


def broken(at_ms: Array, values: Array) -> tuple[Array, Array]:
    """A curve with no value (NaN) wherever its samples are further apart than BREAK_MS."""
    gaps = np.nonzero(np.diff(at_ms) > BREAK_MS)[0] + 1
    return np.insert(at_ms, gaps, at_ms[gaps - 1]), np.insert(values, gaps, np.nan)


def _vibration(axes: Axes, incident: Incident) -> None:
    """The larger of the standard deviations of gyro x and y over the window of 0.5 s that ends there, as telemetry
    judges it; no value where the window holds too few samples."""
    times = np.array([sample.t_ns - incident.cause_ns for sample in incident.imu], dtype=np.int64)
    rates = np.array([sample.rate_radps[:2] for sample in incident.imu], dtype=float).reshape(-1, 2)
    firsts = np.searchsorted(times, times - WINDOW_NS, side="right")
    least = np.maximum(firsts + LEAST_SAMPLES - 1, np.searchsorted(times, times[:1] + WINDOW_NS))
    full = np.nonzero(np.arange(len(times)) >= least)[0]
    spread = np.array([rates[firsts[at] : at + 1].std(axis=0).max() * 1e3 for at in full])
    at, values = broken(times[full] / 1e6, spread)
    limit = incident.number("still.std_radps") * 1e3
    axes.plot(at, values, color=INK, linewidth=1.4)
    axes.fill_between(at, values, limit, where=values > limit, color="C2", alpha=0.3, linewidth=0)
    axes.axhline(limit, color="C1", linewidth=1.2, linestyle="--", label=f"still below {limit:g}")
    axes.set_ylim(0, None)


def _lanes(axes: Axes, incident: Incident) -> None:
    """One lane each for what came, what went out, and who beat."""
    lanes = [("commands", "C0", _at(incident, (tick for tick in incident.ticks if tick.commands)))]
    for sort, (name, color) in WRITTEN.items():
        lanes.append((name, color, _at(incident, (write for write in incident.writes if write.sort == sort))))
    lanes.append(("board heard", "C1", _at(incident, incident.imu)))
    names, colors, times = zip(*lanes, strict=True)
    widths = [2.2 if color == ALARM else 1.0 for color in colors]
    axes.eventplot(times, lineoffsets=range(len(lanes)), linelengths=0.72, linewidths=widths, colors=colors)
    begin_ns, end_ns = incident.span_ns
    for y, process in enumerate(layout.PROCESSES, len(lanes)):
        died = incident.deaths(process)
        last_ns = end_ns
        if incident.head["kind"] == "left":
            last_ns = max(begin_ns, min(end_ns, incident.words(process)["beat_ns"]))
            died.append(last_ns)
        silent = [silence[1:3] for silence in incident.silences() if silence.process == process]
        for spans, height, color in (([(begin_ns, last_ns)], 0.44, BEATS), (silent, 0.64, ALARM)):
            bars = [(incident.ms(since_ns), (until_ns - since_ns) / 1e6) for since_ns, until_ns in spans]
            axes.broken_barh(bars, (y - height / 2, height), color=color, linewidth=0)
        axes.plot([incident.ms(ns) for ns in died], [y] * len(died), "x", color=INK, markersize=6, markeredgewidth=1.8)
    labels = [*names, *(process.replace("_", " ") for process in layout.PROCESSES)]
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


PANELS: tuple[Panel, ...] = (
    ("Velocity (dashed: commanded)", 1.85, _velocity),
    ("Wheel speeds written to the board (rps)", 1.6, _wheels),
    ("The arm: sent (lines), goals (dots), read (crosses); pulses of 0.24 degrees", 1.6, _joints),
    ("Vibration: gyro std over 0.5 s (mrad/s); orange: the wheels turn", 1.3, _vibration),
    ("Who was heard: a stroke each; green: a process beats, red: silent for too long; cross: it died", 2.4, _lanes),
)
"""From the top: title, height in inches, and what draws it; the arm's only where it was moved."""

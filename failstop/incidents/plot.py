"""Plot: draws an incident as one picture. The left half shows the seconds around the stop, and the right half its
milliseconds. The time axis is in ms from the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from io import BytesIO
from math import nan
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from failstop import extras, helpers
from failstop.api import words
from failstop.incidents import files, memory, story
from failstop.incidents.files import IncidentError
from failstop.incidents.incident import DRIVING, SAYS, SILENT, Incident, WriteSort, named
from failstop.incidents.story import Line
from failstop.messages import box, layout
from failstop.policy.proofs import LEAST_SAMPLES, WINDOW_NS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Panel = tuple[str, float, Callable[["Axes", Incident], None]]

FORMATS = (".png", ".svg", ".pdf")
NEEDS = extras.missing("a plot needs matplotlib", "plots")
ZOOM_MS = (-60.0, 140.0)
"""The time range of the right half, ms from the cause. It is wide enough to show ticks of 20 ms, and the repeats of the
stop burst at 20 and 100 ms."""
LEAST_MS = 200.0
"""The picture shows at least this much time before and after the cause, ms, even if the file has less."""
BREAK_MS = 100.0
"""After a pause of this long, a line is interrupted, ms. A board that sends 110 samples a second was silent then."""
LINE_IN = 0.19
"""The height of one line of the story, inches."""
INK, FAINT, ALARM, BEATS_COLOR = "#1b1f24", "#6b7480", "#c62828", "#a9d5c3"
STYLE: Any = {
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.ymargin": 0.16,
    "figure.constrained_layout.w_pad": 0.15,
    "font.size": 9,
    "grid.color": "#e3e7ec",
    "legend.fontsize": 8,
    "text.parse_math": False,
}
AXES = (("vx", "m/s", "limits.vx_mps"), ("vy", "m/s", "limits.vy_mps"), ("wz", "rad/s", "limits.wz_radps"))
WRITTEN = {WriteSort.MOTION: INK, WriteSort.ZERO: FAINT, WriteSort.STOP_BURST: ALARM, WriteSort.PING: "C3"}
"""The kinds of writes that have their own lane, each with its colour."""
SHADES = {
    DRIVING: "white",
    "estop": "#fdeaea",
    box.DISABLED: "#e8ebef",
    box.HELD: "#f3ead7",
    box.NO_COMMAND: "#fff3d1",
    box.NO_SCAN: "#e3effa",
    SILENT: "#e6dff3",
}
"""The background colour for each of the gate's decisions."""


def save(incident: Incident, path: str, seconds: float) -> None:
    """Draw an incident from `seconds` before the cause to its end, and write the picture to `path`, completely or not
    at all. Raises IncidentError."""
    if not path.lower().endswith(FORMATS):
        raise IncidentError(f"{path}: the name must end in {' or '.join(FORMATS)}")
    try:
        helpers.import_elsewhere("matplotlib")
        from matplotlib import style
        from matplotlib.figure import Figure
    except ImportError:
        raise IncidentError(NEEDS) from None
    incident.check_layout()
    # after_reset: without the settings of a matplotlibrc, which may run LaTeX.
    with style.context(["seaborn-v0_8-whitegrid", "seaborn-v0_8-colorblind", STYLE], after_reset=True):
        figure = Figure(dpi=130, facecolor="white", layout="constrained")
        _draw(figure, incident, seconds)
        picture = BytesIO()
        figure.savefig(picture, format=path.rpartition(".")[2].lower())
    files.write_as(path, picture.getvalue())


def _draw(figure: Figure, incident: Incident, seconds: float) -> None:
    """Draw from the top: the title, the panels, the legend of their background, and the story."""
    shown = [panel for panel in PANELS if panel[2] is not _joints or incident.joints()]
    lines = story.brief(incident)
    heights = [height for _, height, _ in shown]
    inches = (0.95, sum(heights) + 0.4, 0.6 + LINE_IN * len(lines))
    figure.set_size_inches(13, sum(inches))
    parts: Any = figure.subfigures(3, 1, height_ratios=inches)
    head, middle, foot = parts
    ratios = {"height_ratios": heights, "width_ratios": (1.9, 1.0)}
    rows = middle.subplots(len(shown), 2, sharex="col", sharey="row", gridspec_kw=ratios)
    begin_ms, end_ms = map(incident.ms, incident.span_ns)
    rows[0][0].set_xlim(max(min(begin_ms, -LEAST_MS), -seconds * 1e3), max(end_ms, LEAST_MS))
    rows[0][1].set_xlim(ZOOM_MS)
    spans = [(what, incident.ms(begin_ns), incident.ms(end_ns)) for what, begin_ns, end_ns in incident.gate_spans()]
    for (title, _, draw), (whole, zoom) in zip(shown, rows, strict=True):
        for axes in (whole, zoom):
            draw(axes, incident)
            for what, from_ms, until_ms in spans:
                axes.axvspan(from_ms, until_ms, zorder=0, linewidth=0, color=SHADES.get(what, "white"))
            axes.axvline(0, color=ALARM, linewidth=1.4, zorder=5)
            for line in lines:
                axes.axvline(incident.ms(line.ns), color=FAINT, linewidth=0.7, alpha=0.5, zorder=1)
        whole.set_title(UNREPORTED if draw is _wheels and not incident.measured else title, color=INK)
        if handles := whole.get_legend_handles_labels()[0]:
            place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.985), "borderaxespad": 0.0}
            whole.legend(handles=handles, ncols=min(len(handles), 6), **place)
    rows[0][1].set_title("Close up", color=FAINT)
    rows[-1][0].set_xlabel("ms from the cause")
    rows[-1][1].set_xlabel("ms from the cause")
    _title(head, incident)
    _foot(foot, incident, lines, {what for what, _, _ in spans})


def _title(figure: SubFigure, incident: Incident) -> None:
    head, reason = incident.head, shorten(incident.reason, 130) or "?"
    figure.text(0.03, 0.55, reason, fontsize=min(19, 1300 / len(reason)), fontweight="bold", color=ALARM)
    figure.text(0.03, 0.28, memory.proven(head), fontsize=11)
    when = words.clock(head["t"])
    figure.text(
        0.03, 0.06, f"{when}   {head['host']}   service {head['name']}   {words.printable(incident.id)}", color=FAINT
    )


def _foot(figure: SubFigure, incident: Incident, lines: list[Line], there: set[str]) -> None:
    """Draw the legend of the background colours in the picture, and the most important lines of the story."""
    from matplotlib.patches import Patch

    patches = [Patch(facecolor=SHADES[what], edgecolor=FAINT, label=SAYS[what]) for what in SHADES if what in there]
    if patches:
        said = {"title": "Background, what the gate said:", "alignment": "left", "ncols": len(patches)}
        figure.legend(handles=patches, loc="upper left", bbox_to_anchor=(0.07, 1.0), **said)
    rows = (f"{incident.ms(line.ns):+9.1f} ms  {named(line.what):<14}{shorten(line.text, 130)}" for line in lines)
    figure.text(0.03, 0.0, "\n".join(rows), family="monospace", linespacing=1.5, va="bottom")


def _at(incident: Incident, entries: Iterable[tuple[Any, ...]]) -> list[float]:
    """The times of these entries, in ms from the cause."""
    return [incident.ms(entry[0]) for entry in entries]


def broken(at_ms: list[float], values: Any, gap_ms: float = BREAK_MS) -> tuple[Any, Any]:
    """Break a curve with NaN wherever two neighbouring points are more than `gap_ms` apart. Returns (times, values)."""
    times, found = np.array(at_ms), np.array(values, dtype=float)
    gaps = np.nonzero(np.diff(times) > gap_ms)[0] + 1
    return np.insert(times, gaps, times[gaps - 1]), np.insert(found, gaps, np.nan)


def _velocity(axes: Axes, incident: Incident) -> None:
    """Draw the commands, and the velocity that the gate decided. A command far above its limit is cut off, so that the
    other curves stay readable."""
    fresh_us = incident.number("gate.command_timeout_s") * 1e6
    old = nan, nan, nan
    asked = [tick.command if (tick.age_us or 0) <= fresh_us else old for tick in incident.ticks]
    at = _at(incident, incident.ticks)
    for index, (name, unit, limit) in enumerate(AXES):
        most, color = incident.number(limit) * 1.3, f"C{index}"
        dashed = np.clip([command[index] for command in asked], -most, most)
        line = np.clip([tick.velocity[index] for tick in incident.ticks], -most, most)
        if np.nan_to_num([dashed, line]).any():
            axes.step(*broken(at, dashed), where="post", color=color, linewidth=1.1, linestyle="--", alpha=0.5)
            axes.step(*broken(at, line), where="post", color=color, label=f"{name} ({unit})")


def _wheels(axes: Axes, incident: Incident) -> None:
    """Draw the wheel speeds that were written to the board and, if known, the reported ones. The written speeds differ
    from the gate's decisions if the port owner refused a frame. Wheels of one side often turn the same way, so every
    other line is wide and pale."""
    frames = [(write.ns, write.speeds_rps) for write in incident.writes if write.speeds_rps]
    for index, name in enumerate(incident.wheels):
        line: dict[str, Any] = {"linewidth": 1.4} if index % 2 else {"linewidth": 4.5, "alpha": 0.3}
        line |= {"where": "post", "label": name, "color": f"C{2 * index // len(incident.wheels)}"}
        axes.step(_at(incident, frames), [speeds[index] for _, speeds in frames], **line)
        if incident.measured:
            measured = [speeds[index] for _, speeds in incident.measured]
            reported = broken(_at(incident, incident.measured), measured, incident.wheels_gap_ns / 1e6)
            style: dict[str, Any] = {
                "linewidth": 1.0,
                "linestyle": ":" if index % 2 else "--",
                "marker": ".",
                "markersize": 3,
            }
            axes.plot(*reported, color=line["color"], **style)


def _joints(axes: Axes, incident: Incident) -> None:
    """Draw where each joint was sent. A servo gets there in about 40 ms, and stops at a stop burst."""
    for servo, sent in sorted(incident.joints().items()):
        axes.plot(*broken(_at(incident, sent), [pulses for _, pulses in sent]), label=incident.joint(servo))


def _vibration(axes: Axes, incident: Incident) -> None:
    """Draw the larger standard deviation of the gyro's x and y over the last 0.5 s. Telemetry uses it to judge whether
    the wheels are still. The curve has a gap where a window has too few samples."""
    times = np.array([sample.t_ns for sample in incident.imu], dtype=np.int64)
    rates = np.array([sample.rate_radps[:2] for sample in incident.imu], dtype=float)
    firsts = np.searchsorted(times, times - WINDOW_NS, side="right")
    spread = [
        np.max(rates[first : at + 1].std(axis=0)) * 1e3 if at + 1 - first >= LEAST_SAMPLES else nan
        for at, first in enumerate(firsts)
    ]
    at_ms, values = broken([incident.ms(sample.t_ns) for sample in incident.imu], spread)
    limit = incident.number("still.std_radps") * 1e3
    axes.plot(at_ms, values, color=INK, linewidth=1.4)
    axes.fill_between(at_ms, values, limit, where=values > limit, color="C2", alpha=0.3, linewidth=0)
    axes.axhline(limit, color="C1", linewidth=1.2, linestyle="--", label=f"still below {limit:g}")
    axes.set_ylim(0, None)


def _lanes(axes: Axes, incident: Incident) -> None:
    """Draw a lane for each kind of message in and out, and for the heartbeat of each process."""
    lanes = [("commands", "C0", _at(incident, (tick for tick in incident.ticks if tick.commands)))]
    for sort, color in WRITTEN.items():
        lanes.append((sort, color, _at(incident, (write for write in incident.writes if write.sort == sort))))
    lanes.append(("board heard", "C1", _at(incident, incident.imu)))
    names, colors, times = zip(*lanes, strict=True)
    # A burst must be visible next to the line of the cause.
    widths = [2.6 if color == ALARM else 1.0 for color in colors]
    axes.eventplot(times, lineoffsets=range(len(lanes)), linelengths=0.72, linewidths=widths, colors=colors)
    begin_ns, end_ns = incident.span_ns
    for y, process in enumerate(layout.PROCESS_NAMES, len(lanes)):
        last_ns = max(begin_ns, min(end_ns, incident.words(process)["beat_ns"]))
        died = [*incident.deaths(process), *[last_ns] * incident.left]
        silent = [silence[1:] for silence in incident.silences() if silence[0] == process]
        for spans, height, color in ((incident.beat_spans(process), 0.44, BEATS_COLOR), (silent, 0.64, ALARM)):
            bars = [(incident.ms(since_ns), (until_ns - since_ns) / 1e6) for since_ns, until_ns in spans]
            axes.broken_barh(bars, (y - height / 2, height), color=color, linewidth=0)
        axes.plot([incident.ms(ns) for ns in died], [y] * len(died), "x", color=INK, markersize=6, markeredgewidth=1.8)
    labels = [*names, *map(named, layout.PROCESS_NAMES)]
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


PANELS: tuple[Panel, ...] = (
    ("Velocity (dashed: commanded)", 1.85, _velocity),
    ("Wheel speeds, rps (dotted: as reported)", 1.6, _wheels),
    ("Where the arm was sent (pulses of 0.24 degrees)", 1.6, _joints),
    ("Vibration: gyro std over 0.5 s (mrad/s); orange: the wheels turn", 1.3, _vibration),
    (
        "Who was heard (a stroke each); green: a process beats, red: silent too long, cross: died, gap: dead",
        2.4,
        _lanes,
    ),
)
"""The panels from the top, each with its title, its height in inches, and the function that draws it. The arm's panel
is drawn only if the arm was moved."""
UNREPORTED = "Wheel speeds written to the board, rps"
"""The title of the wheels' panel if the board reports no wheel speeds."""

"""The story: what happened around a stop, as lines in the order of time, what repeats told once. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TypeVar

from failstop.incidents import outcome, signals
from failstop.incidents.incident import Incident, Tick, Write
from failstop.shm import layout

Entry = TypeVar("Entry")

CAUSE = "CAUSE"
DETAIL_NS = 500_000_000
"""This long before the cause and after it every change is told; what is older, in broad strokes."""
QUIET_NS = 100_000_000
"""A board that sends 110 IMU samples a second and then nothing for this long has gone silent."""
TELL_OF_STOPS = frozenset(("stop", "stop_again", "stop_also"))
"""Events that tell of a stop's cause."""
BLOCKS = {"estop": "a stop is latched", "cmd timeout": "no command"}
"""What the gate's words are for people, where they are not the same."""
STEP = 0.05
"""Near the cause, a command that differs by more (m/s, rad/s) is told of its own."""
STEP_RPS = 0.2


@dataclass(frozen=True)
class Line:
    """One line. `what` is who speaks: command, gate, arm, wire, board, beat, wheels, event kinds, CAUSE."""

    ns: int
    what: str
    text: str
    until_ns: int = 0
    """The last of several that this line stands for; 0: one."""
    count: int = 1


def tell(incident: Incident) -> list[Line]:
    """Every line, in order; what was at the same time in the order of the stop's way."""
    lines = [
        *_commands(incident),
        *_decisions(incident),
        _cause(incident),
        *_arm(incident),
        *_writes(incident),
        *_board(incident),
        *_wheels(incident),
        *_silences(incident),
        *_events(incident),
        *_last_beats(incident),
    ]
    return sorted(lines, key=lambda line: line.ns)


def noticed_by(incident: Incident) -> str:
    """The process that noticed the cause; empty: not known."""
    noticed = [stop.noticed_by for stop in incident.stops if stop.ns == incident.cause_ns]
    stop = incident.head["stop"] or {}
    return stop.get("noticed_by") or (noticed[0] if noticed else "")


def _cause(incident: Incident) -> Line:
    by = noticed_by(incident)
    return Line(incident.cause_ns, CAUSE, f"{incident.reason}{f'; noticed by the {name(by)}' if by else ''}")


def name(process: str) -> str:
    """A process, for people."""
    return process.replace("_", " ")


def _runs(
    entries: list[Entry],
    key: Callable[[Entry], object],
    alike: Callable[[Entry, Entry], bool] = lambda first, entry: True,
) -> Iterator[tuple[Entry, Entry, list[Entry]]]:
    """Neighbours of one key that are like the first of them: (first, last, all)."""
    for _, group in groupby(entries, key):
        run: list[Entry] = []
        for entry in group:
            if run and not alike(run[0], entry):
                yield run[0], run[-1], run
                run = []
            run.append(entry)
        yield run[0], run[-1], run


def block(tick: Tick) -> str:
    """What the gate decided, for people."""
    return BLOCKS.get(tick.block, tick.block)


def _close(one: tuple[float, ...], other: tuple[float, ...], by: float) -> bool:
    """No value differs by more; what is no number is like itself."""
    return all(repr(a) == repr(b) or abs(a - b) <= by for a, b in zip(one, other, strict=True))


def velocity(values: tuple[float, float, float]) -> str:
    """For people: forward, left and turn, those that are not zero."""
    if not any(values):
        return "zero"
    named = zip(("vx", "vy", "wz"), values, ("m/s", "m/s", "rad/s"), strict=True)
    return ", ".join(f"{axis} {value:+.2f} {unit}" for axis, value, unit in named if value)


def _near(incident: Incident, ns: int) -> bool:
    return abs(ns - incident.cause_ns) <= DETAIL_NS


def _commands(incident: Incident) -> Iterator[Line]:
    """Who commanded what. Far from the cause only who; near it each change of velocity that matters."""

    def key(tick: Tick) -> object:
        return tick.who, tick.source, tick.manual, _near(incident, tick.ns)

    def alike(first: Tick, tick: Tick) -> bool:
        return not _near(incident, tick.ns) or _close(first.command, tick.command, STEP)

    heard = [tick for tick in incident.ticks if tick.commands and tick.age_us is not None]
    for first, last, run in _runs(heard, key, alike):
        what = {tick.command for tick in run}
        if len(what) > 1:
            lows, highs = (tuple(f(axis) for axis in zip(*what, strict=True)) for f in (min, max))
            text = f"between {_triple(lows)} and {_triple(highs)}"
        else:
            text = velocity(first.command)
        manual = ", manual" if first.manual else ""
        count = sum(tick.commands for tick in run)
        yield Line(first.ns, "command", f"{first.who} as {first.source}{manual}: {text}", last.ns, count)


def _triple(values: tuple[float, ...]) -> str:
    return "(" + " ".join(f"{value:+.2f}" for value in values) + ")"


def _decisions(incident: Incident) -> Iterator[Line]:
    """Each time the gate decided otherwise."""
    before = ""
    for first, last, _ in _runs(incident.ticks, lambda tick: (tick.block, tick.enabled)):
        if first.block == "driving":
            text = f"lets the wheels turn, {velocity(last.velocity)} at the end"
        else:
            text = f"blocks: {block(first)}"
        yield Line(first.ns, "gate", f"{text}{f' (before: {before})' if before else ''}")
        before = block(first)
    for earlier, later in pairwise(incident.ticks):
        if later.ns - earlier.ns > 2 * signals.allowed_ns(incident, layout.GATE):
            yield Line(earlier.ns, "gate", f"no tick for {(later.ns - earlier.ns) / 1e6:.0f} ms from here")


def _arm(incident: Incident) -> Iterator[Line]:
    """For whom it moved, and where each joint was read to be for the first time after the cause."""
    names = signals.joint_names(incident)
    for first, last, run in _runs(incident.arm_goals, lambda goal: (goal.mode, goal.who)):
        unit = "/s" if last.mode == "jog" else ""
        aims = ", ".join(f"{names.get(servo, servo)} {aim:.0f}{unit}" for servo, aim in last.aims.items())
        text = f"{last.mode} for {last.who}" + (f", last: {aims}" if aims else "") if last.mode else "moved by nobody"
        yield Line(first.ns, "arm", text, last.ns, len(run))
    for servo, track in signals.joint_readings(incident).items():
        if after := [(ns, pulses) for ns, pulses in track if ns >= incident.cause_ns]:
            yield Line(after[0][0], "arm", f"{names.get(servo, servo)} ({servo}) is read to be at {after[0][1]}")


def _writes(incident: Incident) -> Iterator[Line]:
    """What went to the board: bursts one by one, frames of one sort together."""

    def key(write: Write) -> object:
        sort = signals.kind(write)
        near = _near(incident, write.ns)
        after = write.ns >= incident.cause_ns
        alone = write.ns if sort == signals.STOP_BURST and near else 0
        return sort, near, after, alone, write.by, write.taken < write.length

    def alike(first: Write, write: Write) -> bool:
        if signals.kind(write) != signals.MOTION or not _near(incident, write.ns):
            return True
        return _close(signals.speeds_rps(first), signals.speeds_rps(write), STEP_RPS)

    # Pings come between all other frames, and would cut every run.
    pings = [write for write in incident.writes if signals.kind(write) == signals.PING]
    others = [write for write in incident.writes if signals.kind(write) != signals.PING]
    for first, last, run in _runs(others, key, alike):
        yield Line(first.ns, "wire", _written(first, last, len(run)), last.ns, len(run))
    for first, last, run in _runs(pings, lambda ping: ping.ns >= incident.cause_ns):
        yield Line(first.ns, "wire", "pings, which the board answers", last.ns, len(run))


def _written(first: Write, last: Write, count: int) -> str:
    sort = signals.kind(first)
    short = ""
    if first.taken < first.length:
        short = f"; the port took {first.taken} of {first.length} bytes"
    if sort == signals.STOP_BURST:
        text = f"STOP BURST by the {name(first.by)}"
    elif sort == signals.MOTION:
        same = first.head == last.head
        speeds = " ".join(f"{speed:+.3f}" for speed in signals.speeds_rps(last))
        text = f"motion{'' if same or count == 1 else ', last'} [{speeds}] rps"
    elif sort == signals.ZERO:
        text = "zero frame" if count == 1 else "zero frames"
    elif sort == signals.REST:
        text = "the rest of it"
    elif sort == signals.ARM:
        text = "frame for the arm" if count == 1 else "frames for the arm"
    else:
        text = f"frame {first.head[:12].hex(' ')}{' ...' if first.length > 12 else ''}"
    return text + short


def _board(incident: Incident) -> Iterator[Line]:
    """How long the board was heard; its silences."""
    times = [ns for ns, _ in incident.received] or [sample.ns for sample in incident.imu]
    if not times:
        return
    size = sum(len(data) for _, data in incident.received)
    yield Line(times[0], "board", f"is heard{f', {size} bytes' if size else ''}", times[-1], len(times))
    for earlier, later in pairwise(times):
        if later - earlier > QUIET_NS:
            yield Line(earlier, "board", f"silent for {(later - earlier) / 1e6:.0f} ms from here")
    end_ns = incident.span_ns()[1]
    if end_ns - times[-1] > QUIET_NS:
        yield Line(times[-1], "board", f"its last byte; silent until the end, {(end_ns - times[-1]) / 1e6:.0f} ms")


def _wheels(incident: Incident) -> Iterator[Line]:
    """What the IMU says."""
    for ns, still in signals.verdicts(incident):
        yield Line(ns, "wheels", f"the IMU says: {'still' if still else 'they turn'}")


def _silences(incident: Incident) -> Iterator[Line]:
    for silence in signals.silences(incident):
        lasted_ms = (silence.until_ns - silence.since_ns) / 1e6
        yield Line(
            silence.since_ns,
            "beat",
            f"last beat of the {name(silence.process)} for {'' if silence.ended else 'at least '}{lasted_ms:.0f} ms",
            silence.until_ns,
        )


def _last_beats(incident: Incident) -> Iterator[Line]:
    """Of a run that has ended: the last sign of life of each process."""
    if incident.head["kind"] != "left":
        return
    for process in layout.PROCESSES:
        if last_ns := incident.words(process).get("beat_ns"):
            yield Line(last_ns, "beat", f"the last beat of the {name(process)}")


def _events(incident: Incident) -> Iterator[Line]:
    stops = [event.fields for event in incident.events if event.kind in TELL_OF_STOPS]
    for event in incident.events:
        mark = "! " if event.level in ("error", "critical") else ""
        yield Line(event.ns, event.kind, mark + event.text)
    for stop in incident.stops:
        if stop.ns != incident.cause_ns and not any(outcome.tells_of(fields, stop.cause) for fields in stops):
            yield Line(stop.ns, "cause", f"{stop.cause} (noticed by the {name(stop.noticed_by)})")


def within(lines: list[Line], since_ns: int) -> list[Line]:
    """The lines from a moment on; what has begun before it and goes on is told as of then."""
    return [
        line if line.ns >= since_ns else replace(line, ns=since_ns)
        for line in lines
        if line.ns >= since_ns or line.until_ns >= since_ns
    ]

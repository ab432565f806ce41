"""The story: what happened around a stop, as lines in the order of time, what repeats told once. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TypeVar

from failstop.incidents import outcome, signals
from failstop.incidents.incident import ARM, MOTION, PING, REST, STOP_BURST, ZERO, Event, Incident, Tick, Write
from failstop.shm import layout

Entry = TypeVar("Entry")

CAUSE = "CAUSE"
DETAIL_NS = 500_000_000
"""This long before the cause and after it every change is told; what is older, in broad strokes."""
QUIET_NS = 100_000_000
"""A board that sends 110 IMU samples a second and then nothing for this long has gone silent."""
TELL_OF_STOPS = frozenset(("stop", "stop_again", "stop_also"))
"""Events that tell of a stop's cause."""
NO_NEWS = frozenset(
    ("stop_outcome", "stop_also", "incident", "restarting", "gyro", "charger", "ready", "link", "battery", "stopping")
)
"""Events that the facts have already, or that are of no use for the question why."""
BLOCKS = {"estop": "a stop is latched", "cmd timeout": "no command"}
"""What the gate's words are for people, where they are not the same."""
MANY = {ZERO: ("zero frame", "zero frames"), ARM: ("frame for the arm", "frames for the arm")}
"""One frame, and several."""
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
    short: str = ""
    """What the summary has of it, in one row of a terminal if that can be; empty: nothing, it leads nowhere."""


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


def within(lines: list[Line], since_ns: int) -> list[Line]:
    """The lines from a moment on; what has begun before it and goes on is told as of then."""
    there = (line for line in lines if max(line.ns, line.until_ns) >= since_ns)
    return [line if line.ns >= since_ns else replace(line, ns=since_ns) for line in there]


def noticed_by(incident: Incident) -> str:
    """The process that noticed the cause; empty: not known."""
    noticed = [stop.noticed_by for stop in incident.stops if stop.ns == incident.cause_ns]
    return (incident.head["stop"] or {}).get("noticed_by") or (noticed[0] if noticed else "")


def name(process: str) -> str:
    """A process, for people."""
    return process.replace("_", " ")


def block(tick: Tick) -> str:
    """What the gate decided, for people."""
    return BLOCKS.get(tick.block, tick.block)


def velocity(values: tuple[float, float, float]) -> str:
    """For people: forward, left and turn, those that are not zero."""
    if not any(values):
        return "zero"
    named = zip(("vx", "vy", "wz"), values, ("m/s", "m/s", "rad/s"), strict=True)
    return ", ".join(f"{axis} {value:+.2f} {unit}" for axis, value, unit in named if value)


def _plain(ns: int, what: str, text: str, until_ns: int = 0) -> Line:
    """A line that the summary has as it is."""
    return Line(ns, what, text, until_ns, short=text)


def _cause(incident: Incident) -> Line:
    by = noticed_by(incident)
    said = f"{incident.reason}{f'; noticed by the {name(by)}' if by else ''}"
    return Line(incident.cause_ns, CAUSE, said, short=incident.why)


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


def _gaps(times: list[int], most_ns: int) -> Iterator[tuple[int, str]]:
    """Where neighbours are further apart: since when, and for how many ms."""
    for earlier, later in pairwise(times):
        if later - earlier > most_ns:
            yield earlier, f"{(later - earlier) / 1e6:.0f}"


def _close(one: tuple[float, ...], other: tuple[float, ...], by: float) -> bool:
    """No value differs by more; what is no number is like itself."""
    return all(repr(a) == repr(b) or abs(a - b) <= by for a, b in zip(one, other, strict=True))


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
        text = velocity(first.command)
        if len(what) > 1:
            lows, highs = (tuple(map(f, zip(*what, strict=True))) for f in (min, max))
            text = f"between {_triple(lows)} and {_triple(highs)}"
        who = f"{first.who} as {first.source}{', manual' if first.manual else ''}"
        count = sum(tick.commands for tick in run)
        yield Line(first.ns, "command", f"{who}: {text}", last.ns, count, f"{first.who} commands")


def _triple(values: tuple[float, ...]) -> str:
    return "(" + " ".join(f"{value:+.2f}" for value in values) + ")"


def _decisions(incident: Incident) -> Iterator[Line]:
    """Each time the gate decided otherwise."""
    before = ""
    for first, last, _ in _runs(incident.ticks, lambda tick: (tick.block, tick.enabled)):
        short, more = f"blocks: {block(first)}", ""
        if first.block == signals.DRIVING:
            short, more = "lets the wheels turn", f", {velocity(last.velocity)} at the end"
        yield Line(first.ns, "gate", f"{short}{more}{f' (before: {before})' if before else ''}", short=short)
        before = block(first)
    most_ns = 2 * signals.allowed_ns(incident, layout.GATE)
    for ns, lasted_ms in _gaps([tick.ns for tick in incident.ticks], most_ns):
        yield _plain(ns, "gate", f"no tick for {lasted_ms} ms from here")


def _arm(incident: Incident) -> Iterator[Line]:
    """For whom it moved, and where each joint was read to be for the first time after the cause."""
    joints = signals.joints(incident)
    names = {joint.servo: joint.name or joint.servo for joint in joints}
    for first, last, run in _runs(incident.arm_goals, lambda goal: (goal.mode, goal.who)):
        unit = "/s" if last.mode == "jog" else ""
        aims = ", ".join(f"{names.get(servo, servo)} {aim:.0f}{unit}" for servo, aim in last.aims.items())
        text = f"{last.mode} for {last.who}" + (f", last: {aims}" if aims else "") if last.mode else "moved by nobody"
        yield Line(first.ns, "arm", text, last.ns, len(run), text)
    for joint in joints:
        if after := [(ns, pulses) for ns, pulses in joint.read if ns >= incident.cause_ns]:
            yield _plain(after[0][0], "arm", f"{names[joint.servo]} ({joint.servo}) is read to be at {after[0][1]}")


def _writes(incident: Incident) -> Iterator[Line]:
    """What went to the board: bursts one by one, frames of one sort together. The summary has those after the cause but
    for routine, and what the port did not take."""

    def key(write: Write) -> object:
        near = _near(incident, write.ns)
        alone = write.ns if write.sort == STOP_BURST and near else 0
        return write.sort, near, write.ns >= incident.cause_ns, alone, write.by, write.taken < write.length

    def alike(first: Write, write: Write) -> bool:
        if first.sort != MOTION or not (_near(incident, write.ns) and first.speeds_rps and write.speeds_rps):
            return True
        return _close(first.speeds_rps, write.speeds_rps, STEP_RPS)

    # Pings come between all other frames, and would cut every run.
    pings = [write for write in incident.writes if write.sort == PING]
    others = [write for write in incident.writes if write.sort != PING]
    for first, last, run in _runs(others, key, alike):
        text = _written(first, last, len(run))
        short = text if first.ns >= incident.cause_ns and first.sort != ZERO else ""
        if first.taken < first.length:
            short = text = f"{text}; the port took {first.taken} of {first.length} bytes"
        yield Line(first.ns, "wire", text, last.ns, len(run), short)
    for first, last, run in _runs(pings, lambda ping: ping.ns >= incident.cause_ns):
        yield Line(first.ns, "wire", "pings, which the board answers", last.ns, len(run))


def _written(first: Write, last: Write, count: int) -> str:
    if first.sort == STOP_BURST:
        return f"STOP BURST by the {name(first.by)}"
    if first.sort == MOTION:
        speeds = " ".join(f"{speed:+.3f}" for speed in last.speeds_rps or ())
        return f"motion{'' if first.head == last.head else ', last'} [{speeds}] rps"
    if first.sort in MANY:
        return MANY[first.sort][count > 1]
    return "the rest of it" if first.sort == REST else f"frame {first.head[:12].hex(' ')}{' ...' * (first.length > 12)}"


def _board(incident: Incident) -> Iterator[Line]:
    """How long the board was heard; its silences."""
    times = [ns for ns, _ in incident.received] or [sample.ns for sample in incident.imu]
    if not times:
        return
    size = sum(len(data) for _, data in incident.received)
    yield Line(times[0], "board", f"is heard{f', {size} bytes' if size else ''}", times[-1], len(times))
    for ns, lasted_ms in _gaps(times, QUIET_NS):
        yield _plain(ns, "board", f"silent for {lasted_ms} ms from here")
    for ns, lasted_ms in _gaps([times[-1], incident.span_ns()[1]], QUIET_NS):
        yield _plain(ns, "board", f"its last byte; silent until the end, {lasted_ms} ms")


def _wheels(incident: Incident) -> Iterator[Line]:
    """What the IMU says."""
    for ns, still in signals.verdicts(incident):
        yield _plain(ns, "wheels", f"the IMU says: {'still' if still else 'they turn'}")


def _silences(incident: Incident) -> Iterator[Line]:
    for silence in signals.silences(incident):
        lasted = f"{'' if silence.ended else 'at least '}{(silence.until_ns - silence.since_ns) / 1e6:.0f} ms"
        said = f"last beat of the {name(silence.process)} for {lasted}"
        yield _plain(silence.since_ns, "beat", said, silence.until_ns)


def _last_beats(incident: Incident) -> Iterator[Line]:
    """Of a run that has ended: the last sign of life of each process."""
    for process in layout.PROCESSES if incident.head["kind"] == "left" else ():
        if last_ns := incident.words(process).get("beat_ns"):
            yield _plain(last_ns, "beat", f"the last beat of the {name(process)}")


def _events(incident: Incident) -> Iterator[Line]:
    for event in incident.events:
        text = f"{'! ' if event.level in ('error', 'critical') else ''}{event.text}"
        short = text.partition("; next: ")[0].partition(" (was: ")[0]
        yield Line(event.ns, event.kind, text, short=short if _leads(incident, event) else "")
    stops = [event.fields for event in incident.events if event.kind in TELL_OF_STOPS]
    for stop in incident.stops:
        if stop.ns != incident.cause_ns and not any(outcome.tells_of(fields, stop.cause) for fields in stops):
            yield _plain(stop.ns, "cause", f"{stop.cause} (noticed by the {name(stop.noticed_by)})")


def _leads(incident: Incident, event: Event) -> bool:
    """Whether the summary has it; of the stop itself it has the facts."""
    if event.kind != "stop" or event.ns < incident.cause_ns:
        return event.kind not in NO_NEWS
    return not event.text.partition(": ")[2].startswith(incident.reason)

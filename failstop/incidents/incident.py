"""Incident: a saved file, decoded into series over time. Entries that can't be decoded are counted."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import groupby, pairwise
from math import isnan
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from failstop.api.events import Event, unpack
from failstop.api.snapshot import Imu
from failstop.board.kinds import board_of
from failstop.board.servos import HIGHEST_ID, LONGEST_MOVE_MS
from failstop.incidents import files
from failstop.incidents.files import IncidentError
from failstop.messages import box, layout, records
from failstop.policy import causes
from failstop.policy.layouts import BOARDS, WHEEL_NAMES, wheel_ids
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.policy.setting import SettingError
from failstop.policy.settings import BY_KEY, Settings

if TYPE_CHECKING:
    from failstop.board.interface import Board

Payload = TypeVar("Payload")
DRIVING = "driving"
SILENT = "silent"
SAYS = {
    DRIVING: "the wheels may turn",
    "estop": "a stop is latched",
    box.DISABLED: "motion is disabled",
    box.HELD: "commanded before motion was enabled",
    box.NO_COMMAND: "no command",
    box.NO_SCAN: "no obstacle sensor",
    SILENT: "the gate is silent",
}
"""What people read for each of the gate's decisions, and for a gate that is silent."""
QUIET_NS = 100_000_000
"""After this long without a sample, a board that sends 110 IMU samples a second counts as silent."""
USUAL_GAPS = 2.5
"""How long a gap between two reports of the wheels is, as a multiple of the usual time between them. It applies to
boards that report slowly."""
SLOWEST_RPS = 1e-4
"""A wheel that turns slower than this counts as still."""
EVERY_ID = range(1, HIGHEST_ID + 1)
"""The ids that a servo of an arm may have."""


class Tick(NamedTuple):
    """One decision of the gate."""

    ns: int
    epoch: int
    block: str
    """The decision, one of box.DECISIONS."""
    enabled: bool
    manual: bool
    drives: bool
    """True if `command` is the one that drives."""
    commands: int
    """How many commands arrived since the tick before."""
    age_us: int | None
    """The age of `command`, us. None if no command has arrived yet."""
    command: tuple[float, float, float]
    """The newest command, or one that drives and has no tick yet: m/s forward, m/s left, rad/s counter-clockwise. It is
    unchecked, so it may also be NaN."""
    velocity: tuple[float, float, float]
    """The velocity that the gate decided."""
    wheels_rps: tuple[float, ...]
    source: str
    who: str


HEARERS = (layout.TELEMETRY, layout.PORT_OWNER)
"""The processes that record the bytes from the board."""


class WriteSort:
    """The kinds of writes to the port. MOTION: a motor frame that moves a wheel. ZERO: a motor frame with only zeros.
    ARM: a frame for the arm's servos. REST: the rest of a write that the kernel first took only in part."""

    MOTION, ZERO, ARM, PING, OTHER, STOP_BURST, REST = "motion", "zero", "arm", "ping", "other", "stop burst", "rest"


class PortWrite(NamedTuple):
    """One write to the port."""

    ns: int
    by: str
    sort: str
    """What was written, one of WriteSort."""
    length: int = 0
    taken: int = 0
    """How many bytes the kernel took at once."""
    head: bytes = b""
    """The first bytes of the frame."""
    speeds_rps: tuple[float, ...] | None = None
    """The wheel speeds that this write sets, in the order of Incident.wheels. None if it sets none."""


class Incident:
    """One incident file, decoded. Its times are CLOCK_MONOTONIC ns, and ms() converts them to ms from the cause."""

    def __init__(self, identity: str, head: dict[str, Any], body: dict[str, Any]) -> None:
        """Raises KeyError or TypeError if the maps are not those of an incident."""
        self.id = identity
        self.head = head
        self.cause_ns: int = head["cause_ns"]
        self.reason: str = head["reason"]
        self.cause = causes.of(head["cause"]["name"], head["cause"])
        self.settings: dict[str, str] = body["settings"]
        self.machine: dict[str, Any] = body["machine"]
        self._segments: dict[str, Any] = body["segments"]
        self.foreign = head["layout"] != layout.LAYOUT_VERSION
        """True if the file was saved by a version of failstop with another record layout. Then only the head and the
        events can be read."""
        self.undecoded = 0
        self.ticks = [Tick(ns, **found) for ns, found in self._entries(layout.GATE, "box", box.unpack_gate)]
        """The gate's decisions, one for each tick."""
        supervisor = self._entries(layout.SUPERVISOR, "box", box.unpack_beats)
        self.beats = [(ns, times) for ns, times in supervisor if times]
        """(time, silences), each time with one (silent_us, before_us) for each process of layout.PROCESS_NAMES.
        `silent_us` is the process's longest silence since the sample before. `before_us` is how long before this sample
        that silence was seen."""
        wire = self._entries(layout.PORT_OWNER, "box", box.WIRE.unpack)
        last_ns = self.words(layout.STOPPER).get("written_ns", 0)
        ids = wheel_ids(self.settings)
        self.wheels = WHEEL_NAMES[len(ids)]
        """The names of the wheels, in the order in which the settings number them."""
        spoken = self._board()
        writes = [_write(spoken, ids, ns, layout.PORT_OWNER, *written) for ns, written in wire]
        writes += [_write(spoken, ids, ns, layout.SUPERVISOR, box.WIRE_BURST) for ns, times in supervisor if not times]
        writes += [_write(spoken, ids, last_ns, layout.STOPPER, box.WIRE_BURST)] * (last_ns > 0)
        self.writes = sorted(writes, key=lambda write: write.ns)
        """Everything that was written to the board, in order: the writes of the port owner, the stop bursts of the
        supervisor, and the last one of the stopper."""
        board: list[tuple[int, tuple[int, Any]]] = self._entries(layout.TELEMETRY, "box", box.unpack_board)
        self.imu = [Imu(ns, values[:3], values[3:]) for ns, (kind, values) in board if kind == box.IMU_KIND]
        self.battery_v = [(ns, values[0] / 1e3) for ns, (kind, values) in board if kind == box.BATTERY_KIND]
        """(time, volts) for each reading."""
        self._servos_ns = [ns for ns, (kind, _) in board if kind == box.SERVO_KIND]
        self.measured = [
            (ns, tuple(values[wire_id] for wire_id in ids))
            for ns, (kind, values) in board
            if kind == box.WHEELS_KIND and not any(isnan(values[wire_id]) for wire_id in ids)
        ]
        """(time, speeds) for each report of the wheels. The speeds are turns per second, in the order of
        PortWrite.speeds_rps."""
        self.arm_goals = self._entries(layout.GATE, "arm_box", box.unpack_arm)
        """(time, (mode, who, aims)): where the arm was to move, ten times a second while somebody moved it."""
        heard = [self._entries(process, "received", bytes) for process in HEARERS]
        self.received = sorted(heard[0] + heard[1], key=lambda entry: entry[0])
        """(time, bytes) of everything that the board sent in the last seconds. Usually the telemetry process recorded
        it. While telemetry was not running, the port owner did."""
        self.received_from_ns = [at_ns for process in HEARERS if (at_ns := self._first_kept_ns(process, "received"))]
        """For each ring that has lost its oldest entries: the time of the oldest bytes that are left."""
        noticed = [
            (cause_ns, segment, causes.read(cause))
            for segment in (layout.PORT_OWNER, layout.GATE)
            for _, (_, cause_ns, _, cause) in self._entries(segment, "stops", records.STOPPED.unpack)
        ]
        self.stops = sorted(noticed, key=lambda stop: stop[0])
        """(time, process, cause) for every cause that the port owner or the gate noticed."""
        told: list[tuple[int, Event]] = self._entries(layout.SUPERVISOR, "events", lambda payload: unpack(0, payload))
        self.events = [event for _, event in told]
        """The logged events."""
        times = [found[0] for series in (self.ticks, self.writes, self.imu, self.beats) for found in series]
        self.span_ns = min(times, default=self.cause_ns), max(times, default=self.cause_ns)
        """The oldest and the newest time in the file."""

    @classmethod
    def read(cls, path: str) -> Incident:
        """Read an incident from its file. Raises IncidentError."""
        head, body = files.read(path)
        with files.as_written(path):
            return cls(files.identity(path), head, body)

    def _entries(self, segment: str, name: str, decode: Callable[[bytes], Payload | None]) -> list[tuple[int, Payload]]:
        """The decoded entries of a ring, as (time, entry). Entries that can't be decoded are left out, and counted in
        `undecoded`."""
        found: list[tuple[int, Payload]] = []
        # Events can be read whatever the layout is, because their parts have names.
        if self.foreign and name != "events":
            return found
        for _, ns, payload in self._segments.get(segment, {}).get("rings", {}).get(name, []):
            try:
                entry = decode(payload)
            except (ValueError, KeyError, TypeError, IndexError):
                entry = None
            if entry is None:
                self.undecoded += 1
            else:
                found.append((ns, entry))
        return found

    def _first_kept_ns(self, segment: str, name: str) -> int:
        """The time of a ring's oldest entry if older entries were overwritten. Otherwise 0."""
        kept = self._segments.get(segment, {}).get("rings", {}).get(name, [])
        return int(kept[0][1]) if kept and kept[0][0] > 1 else 0

    @property
    def why(self) -> str:
        """The reason of the stop, without the name of its requester."""
        return causes.unsigned(self.cause) if self.cause.kind in causes.SIGNED else self.reason

    @property
    def left(self) -> bool:
        """True if this incident was saved from the memory of a run that ended unexpectedly."""
        return bool(self.head["kind"] == "left")

    def check_layout(self) -> None:
        """Raise IncidentError if this version can't read the incident's records."""
        if self.foreign:
            raise IncidentError(
                f"{self.id} was saved by failstop {self.head['versions']['failstop']}, which stored its records "
                "differently: use that version for this; `failstop incident show` shows the logged events"
            )

    def ms(self, ns: int) -> float:
        """A time in ms from the cause."""
        return (ns - self.cause_ns) / 1e6

    def number(self, key: str) -> float:
        """The value of a setting. If the file does not have it, its default."""
        return float(self.settings.get(key, BY_KEY[key].default))

    def driver(self, last: Tick) -> Tick | None:
        """The newest tick with a command that drove at the tick `last`. None if no tick has that command. Files of
        older versions may lack it, if another source sent too."""
        found = next((tick for tick in reversed(self.ticks) if tick.drives and tick.ns <= last.ns), None)
        if found is None or found is last:
            return found
        timeout_s = self.settings.get(f"sources.{found.source}.timeout_s") or self.number("gate.command_timeout_s")
        age_ns = last.ns - found.ns + (found.age_us or 0) * 1000
        return found if age_ns <= float(timeout_s) * 1e9 else None

    def words(self, segment: str) -> dict[str, int]:
        """The words (single numbers) of a segment of shared memory, by their names."""
        return dict(self._segments.get(segment, {}).get("words", {}))

    def allowed_ns(self, process: str) -> int:
        """How long a process may be silent before the robot is stopped for it, ns."""
        if process in (layout.GATE, layout.SUPERVISOR):
            return round(self.number("gate.lease_s") * 1e9)
        return PROCESS_BY_NAME[process].deadline_ns

    def silences(self) -> list[tuple[str, int, int]]:
        """(process, time of its last beat, time when it was last seen silent) for each silence that was too long, as
        the supervisor saw it. The supervisor notices its own silences only afterwards."""
        found = []
        for index, process in enumerate(layout.PROCESS_NAMES):
            allowed_us = self.allowed_ns(process) / 1000
            seen = [(times[index][0] > allowed_us, ns, *times[index]) for ns, times in self.beats]
            for late, run in groupby(seen, itemgetter(0)):
                spans = [(ns - (us + before_us) * 1000, ns - before_us * 1000) for _, ns, us, before_us in run]
                found += [(process, spans[0][0], spans[-1][1])] * late
        return found

    def deaths(self, process: str) -> list[int]:
        """When the death of this process was logged."""
        return [event.ns for event in self.events if event.kind == "died" and event.fields.get("process") == process]

    def beat_spans(self, process: str) -> list[tuple[int, int]]:
        """(begin, end) of each period in which a process was beating. Each death leaves a gap, from the process's last
        beat to the last time when it was seen silent."""
        index, (begin_ns, end_ns) = layout.PROCESS_NAMES.index(process), self.span_ns
        last_ns = max(begin_ns, min(end_ns, self.words(process)["beat_ns"]))
        silent = []
        for ns, times in self.beats:
            silent_us, before_us = times[index]
            silent.append((ns - (silent_us + before_us) * 1000, ns - before_us * 1000))
        found, since_ns = [], begin_ns
        for died_ns in self.deaths(process):
            dead = [(beat_ns, seen_ns) for beat_ns, seen_ns in silent if beat_ns <= died_ns < seen_ns]
            found.append((since_ns, min(last_ns, max((beat_ns for beat_ns, _ in dead), default=died_ns))))
            again_ns = [ns for ns in (*(beat_ns for beat_ns, _ in silent), last_ns) if ns > died_ns]
            back_ns = min(again_ns, default=last_ns)
            since_ns = max((seen_ns for _, seen_ns in dead), default=back_ns) if again_ns else back_ns
        return [(since_ns, until_ns) for since_ns, until_ns in (*found, (since_ns, last_ns)) if since_ns < until_ns]

    def gate_spans(self) -> list[tuple[str, int, int]]:
        """(decision, begin, end) of each period from the first tick to the end of the file, without gaps. The decision
        is SILENT while the gate missed its ticks or was dead."""
        allowed, died = self.allowed_ns(layout.GATE), self.deaths(layout.GATE)
        parts: list[tuple[str, int, int]] = []
        for tick, end_ns in zip(self.ticks, [*(tick.ns for tick in self.ticks[1:]), self.span_ns[1]], strict=False):
            silent = end_ns - tick.ns > allowed or any(tick.ns < ns < end_ns for ns in died)
            parts.append((SILENT if silent else tick.block, tick.ns, end_ns))
        runs = [(what, list(run)) for what, run in groupby(parts, itemgetter(0))]
        return [(what, run[0][1], run[-1][2]) for what, run in runs]

    @cached_property
    def wheels_gap_ns(self) -> int:
        """The longest usual time between two reports of the wheels, ns. After a longer gap, reports are missing."""
        apart = sorted(later - earlier for (earlier, _), (later, _) in pairwise(self.measured))
        return max(QUIET_NS, round(USUAL_GAPS * apart[len(apart) // 2])) if apart else QUIET_NS

    def rolled(self) -> list[tuple[bool, int, int, float, int]]:
        """(True if the wheels turn, begin, end, fastest speed in turns per second, number of reports) for each period
        in which the board reported turning or still wheels. A gap in the reports ends a period."""
        found: list[tuple[bool, int, int, float, int]] = []
        for ns, speeds in self.measured:
            fastest = max(map(abs, speeds), default=0.0)
            turn = fastest >= SLOWEST_RPS
            if found and found[-1][0] == turn and ns - found[-1][2] <= self.wheels_gap_ns:
                _, begin_ns, _, before, count = found[-1]
                found[-1] = (turn, begin_ns, ns, max(before, fastest), count + 1)
            else:
                found.append((turn, ns, ns, fastest, 1))
        return found

    def ages(self) -> dict[str, float | None]:
        """The age of the newest reading of each kind at the cause, s. The keys are `wheels_s` and those of State.ages
        except `odometry_s`. A value is None if the file has no reading from before the cause."""
        readings = {
            "board_s": [ns for ns, _ in self.received],
            "wheels_s": [ns for ns, _ in self.measured],
            "imu_s": [sample.t_ns for sample in self.imu],
            "battery_s": [ns for ns, _ in self.battery_v],
            "servos_s": self._servos_ns,
        }
        newest = {name: [ns for ns in times if ns <= self.cause_ns] for name, times in readings.items()}
        return {name: round((self.cause_ns - max(times)) / 1e9, 3) if times else None for name, times in newest.items()}

    def _board(self) -> Board | None:
        """The board that the settings name. None for a user's own board, because reading a file must not run a user's
        code."""
        kind = str(self.settings.get("board.kind", BY_KEY["board.kind"].default))
        if kind not in BOARDS:
            return None
        lines = "\n".join(f"{key}={value}" for key, value in self.settings.items())
        try:
            return board_of(*Settings.from_lines(lines).board())
        except (SettingError, ValueError):  # these settings are from another version of failstop
            return board_of(kind, self.number("wheels.diameter_m"), self.number("board.per_rps"))

    def joint(self, servo: int) -> str:
        """The name of the arm's joint with this servo, from the settings."""
        named = (key.split(".") for key, value in self.settings.items() if value == str(servo))
        return next((key[1] for key in named if key[0] == "joints" and key[2:] == ["servo"]), f"servo {servo}")

    def joints(self) -> dict[int, list[tuple[int, int]]]:
        """Where each servo of the arm was sent, by its number, as (time, pulses)."""
        found: dict[int, list[tuple[int, int]]] = {}
        board = self._board()
        bus = board.arm if board else None
        for write in self.writes if bus else ():
            for servo, position, _ in bus.moves(write.head) if bus and write.taken else ():
                found.setdefault(servo, []).append((write.ns, position))
        return found


def _write(
    board: Board | None, ids: list[int], ns: int, by: str, kind: int, length: int = 0, taken: int = 0, head: bytes = b""
) -> PortWrite:
    """Make a PortWrite. `kind`: the kind that box.pack_wire() recorded. `ids`: the wheels' ids on the wire."""
    speeds: tuple[float, ...] | None = None
    if kind == box.WIRE_BURST:
        sort, speeds = WriteSort.STOP_BURST, (0.0,) * len(ids)
    elif kind == box.WIRE_REST:
        sort = WriteSort.REST
    elif board and (found := board.speeds(board.stop if head == board.refresh else head)) is not None:
        speeds = tuple(found[wire_id] for wire_id in ids)
        sort = WriteSort.MOTION if any(speeds) else WriteSort.ZERO
    elif board and board.arm and not board.arm.check(head, EVERY_ID, LONGEST_MOVE_MS):
        sort = WriteSort.ARM
    else:
        sort = WriteSort.PING if board and head in board.pings else WriteSort.OTHER
    return PortWrite(ns, by, sort, length, taken, head, speeds)


def named(process: str) -> str:
    """The name of a process, for people."""
    return process.replace("_", " ")

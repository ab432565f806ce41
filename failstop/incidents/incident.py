"""Incident: a saved file, decoded into series over time, and what follows from them. What can't be is counted."""

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
"""The gate's word, or that it says nothing, for people."""
QUIET_NS = 100_000_000
"""A board that sends 110 IMU samples a second and then nothing for this long has gone silent."""
USUAL_GAPS = 2.5
"""Reports that come less often have a gap where the next one takes this many times as long as usual."""
SLOWEST_RPS = 1e-4
"""A wheel that is reported to turn slower than this is still."""
EVERY_ID = range(1, HIGHEST_ID + 1)
"""The ids that a servo of an arm may have."""


class Tick(NamedTuple):
    """A decision of the gate, at one tick."""

    ns: int
    epoch: int
    block: str
    """A word of box.DECISIONS."""
    enabled: bool
    manual: bool
    drives: bool
    """The newest command is the one that drives."""
    commands: int
    """How many commands came since the tick before."""
    age_us: int | None
    """The age of the newest command, us. None: no command came yet."""
    command: tuple[float, float, float]
    """m/s forward, m/s left, rad/s counter-clockwise; may be anything, NaN too."""
    velocity: tuple[float, float, float]
    """The gate's own command for it."""
    wheels_rps: tuple[float, ...]
    source: str
    who: str


HEARERS = (layout.TELEMETRY, layout.PORT_OWNER)
"""Processes that keep the board's bytes."""


class WriteSort:
    """The sort of a write: a motor frame that moves a wheel, one of zeros, a frame for the arm's servos, ..., the rest
    of what the kernel had not taken."""

    MOTION, ZERO, ARM, PING, OTHER, STOP_BURST, REST = "motion", "zero", "arm", "ping", "other", "stop burst", "rest"


class PortWrite(NamedTuple):
    """One write to the port."""

    ns: int
    by: str
    sort: str
    """What was written: one of WriteSort."""
    length: int = 0
    taken: int = 0
    """Bytes that the kernel took at once."""
    head: bytes = b""
    """The frame's first bytes."""
    speeds_rps: tuple[float, ...] | None = None
    """The speeds that it sets, in the order of Incident.wheels; None: it sets none."""


class Incident:
    """One file, whole. `ms(ns)` is relative to the cause."""

    def __init__(self, identity: str, head: dict[str, Any], body: dict[str, Any]) -> None:
        """Raises KeyError, TypeError for what is no incident."""
        self.id = identity
        self.head = head
        self.cause_ns: int = head["cause_ns"]
        self.reason: str = head["reason"]
        self.cause = causes.of(head["cause"]["name"], head["cause"])
        self.settings: dict[str, str] = body["settings"]
        self.machine: dict[str, Any] = body["machine"]
        self._segments: dict[str, Any] = body["segments"]
        self.foreign = head["layout"] != layout.LAYOUT_VERSION
        """Saved by a version that laid its records out otherwise: only the head and the events are read."""
        self.undecoded = 0
        self.ticks = [Tick(ns, **found) for ns, found in self._entries(layout.GATE, "box", box.unpack_gate)]
        """The gate's decisions."""
        supervisor = self._entries(layout.SUPERVISOR, "box", box.unpack_beats)
        self.beats = [(ns, times) for ns, times in supervisor if times]
        """(when, (silent_us, before_us) of each process: its longest silence since the sample before, and how long
        before this sample that was seen), as layout.PROCESS_NAMES."""
        wire = self._entries(layout.PORT_OWNER, "box", box.WIRE.unpack)
        last_ns = self.words(layout.STOPPER).get("written_ns", 0)
        ids = wheel_ids(self.settings)
        self.wheels = WHEEL_NAMES[len(ids)]
        """The names of the wheels, in the order of their numbers."""
        spoken = self._board()
        writes = [_write(spoken, ids, ns, layout.PORT_OWNER, *written) for ns, written in wire]
        writes += [_write(spoken, ids, ns, layout.SUPERVISOR, box.WIRE_BURST) for ns, times in supervisor if not times]
        writes += [_write(spoken, ids, last_ns, layout.STOPPER, box.WIRE_BURST)] * (last_ns > 0)
        self.writes = sorted(writes, key=lambda write: write.ns)
        """Everything for the board, in order: the port owner's, the supervisor's bursts, the stopper's last one."""
        board: list[tuple[int, tuple[int, Any]]] = self._entries(layout.TELEMETRY, "box", box.unpack_board)
        self.imu = [Imu(ns, values[:3], values[3:]) for ns, (kind, values) in board if kind == box.IMU_KIND]
        self.battery_v = [(ns, values[0] / 1e3) for ns, (kind, values) in board if kind == box.BATTERY_KIND]
        """(when, volts)."""
        self._servos_ns = [ns for ns, (kind, _) in board if kind == box.SERVO_KIND]
        self.measured = [
            (ns, tuple(values[wire_id] for wire_id in ids))
            for ns, (kind, values) in board
            if kind == box.WHEELS_KIND and not any(isnan(values[wire_id]) for wire_id in ids)
        ]
        """(when, the speed of each wheel in turns a second, as PortWrite.speeds_rps): the board's reports of them."""
        self.arm_goals = self._entries(layout.GATE, "arm_box", box.unpack_arm)
        """(when, (mode, who, aims)): what the arm was to do, ten times a second while somebody moved it."""
        heard = [self._entries(process, "received", bytes) for process in HEARERS]
        self.received = sorted(heard[0] + heard[1], key=lambda entry: entry[0])
        """Bytes from the board, of the last seconds; the port owner's are of while no telemetry ran."""
        self.received_from_ns = [at_ns for process in HEARERS if (at_ns := self._first_kept_ns(process, "received"))]
        """When the oldest bytes came that a ring still has, of each ring that has lost older ones. The file does not
        have what was heard before."""
        noticed = [
            (cause_ns, segment, causes.read(cause))
            for segment in (layout.PORT_OWNER, layout.GATE)
            for _, (_, cause_ns, _, cause) in self._entries(segment, "stops", records.STOPPED.unpack)
        ]
        self.stops = sorted(noticed, key=lambda stop: stop[0])
        """(when, by whom, cause): every cause that port owner and gate noticed."""
        told: list[tuple[int, Event]] = self._entries(layout.SUPERVISOR, "events", lambda payload: unpack(0, payload))
        self.events = [event for _, event in told]
        """Events for people."""
        times = [found[0] for series in (self.ticks, self.writes, self.imu, self.beats) for found in series]
        self.span_ns = min(times, default=self.cause_ns), max(times, default=self.cause_ns)
        """The oldest and the newest moment that is in the file."""

    @classmethod
    def read(cls, path: str) -> Incident:
        """Raises IncidentError."""
        head, body = files.read(path)
        with files.as_written(path):
            return cls(files.identity(path), head, body)

    def _entries(self, segment: str, name: str, decode: Callable[[bytes], Payload | None]) -> list[tuple[int, Payload]]:
        """A ring's (when, what)."""
        found: list[tuple[int, Payload]] = []
        # Events name their parts, whatever the layout.
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
        """When the oldest entry of a ring was made, if older ones were overwritten; 0: none were."""
        kept = self._segments.get(segment, {}).get("rings", {}).get(name, [])
        return int(kept[0][1]) if kept and kept[0][0] > 1 else 0

    @property
    def why(self) -> str:
        """The reason without who asked for it."""
        return causes.unsigned(self.cause) if self.cause.kind in causes.SIGNED else self.reason

    @property
    def left(self) -> bool:
        """It is of a run that ended without an order, as the next start found it in memory."""
        return bool(self.head["kind"] == "left")

    def check_layout(self) -> None:
        """Raise IncidentError for one whose records this version can't read."""
        if self.foreign:
            raise IncidentError(
                f"{self.id} was saved by failstop {self.head['versions']['failstop']}, which stored its records "
                "differently: use that version for this; `failstop incident show` shows the logged events"
            )

    def ms(self, ns: int) -> float:
        """Milliseconds from the cause."""
        return (ns - self.cause_ns) / 1e6

    def number(self, key: str) -> float:
        """A setting; its default where the file has none."""
        return float(self.settings.get(key, BY_KEY[key].default))

    def words(self, segment: str) -> dict[str, int]:
        """The words of a segment."""
        return dict(self._segments.get(segment, {}).get("words", {}))

    def allowed_ns(self, process: str) -> int:
        """How long a process may be silent without anybody minding."""
        if process in (layout.GATE, layout.SUPERVISOR):
            return round(self.number("gate.lease_s") * 1e9)
        return PROCESS_BY_NAME[process].deadline_ns

    def silences(self) -> list[tuple[str, int, int]]:
        """(process, its last beat before, when it was last seen to be silent) of each that was silent for too long, as
        the supervisor saw it; of its own silences, those that it noticed afterwards."""
        found = []
        for index, process in enumerate(layout.PROCESS_NAMES):
            allowed_us = self.allowed_ns(process) / 1000
            seen = [(times[index][0] > allowed_us, ns, *times[index]) for ns, times in self.beats]
            for late, run in groupby(seen, itemgetter(0)):
                spans = [(ns - (us + before_us) * 1000, ns - before_us * 1000) for _, ns, us, before_us in run]
                found += [(process, spans[0][0], spans[-1][1])] * late
        return found

    def deaths(self, process: str) -> list[int]:
        """When it was told that a process had died."""
        return [event.ns for event in self.events if event.kind == "died" and event.fields.get("process") == process]

    def gate_spans(self) -> list[tuple[str, int, int]]:
        """(What the gate said, from when, until when), without gaps; where it missed its ticks or was dead, SILENT."""
        allowed, died = self.allowed_ns(layout.GATE), self.deaths(layout.GATE)
        parts: list[tuple[str, int, int]] = []
        for tick, end_ns in zip(self.ticks, [*(tick.ns for tick in self.ticks[1:]), self.span_ns[1]], strict=False):
            silent = end_ns - tick.ns > allowed or any(tick.ns < ns < end_ns for ns in died)
            parts.append((SILENT if silent else tick.block, tick.ns, end_ns))
        runs = [(what, list(run)) for what, run in groupby(parts, itemgetter(0))]
        return [(what, run[0][1], run[-1][2]) for what, run in runs]

    @cached_property
    def wheels_gap_ns(self) -> int:
        """Between two reports of the wheels that are further apart than this, some were missed."""
        apart = sorted(later - earlier for (earlier, _), (later, _) in pairwise(self.measured))
        return max(QUIET_NS, round(USUAL_GAPS * apart[len(apart) // 2])) if apart else QUIET_NS

    def rolled(self) -> list[tuple[bool, int, int, float, int]]:
        """(whether they turn, first seen so, last seen so, the fastest in turns a second, how many reports said so):
        what the board's reports say of the wheels, in order. A gap in the reports ends an entry, because nothing says
        what the wheels did meanwhile."""
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
        """How old the newest reading of each kind was at the cause, in s, named as in State.ages; None: the file has no
        reading from before it. That of the wheels is called `wheels_s`."""
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
        """The board that the settings name; None: of the user's own, whose code no reader of a file runs."""
        kind = str(self.settings.get("board.kind", BY_KEY["board.kind"].default))
        if kind not in BOARDS:
            return None
        lines = "\n".join(f"{key}={value}" for key, value in self.settings.items())
        try:
            return board_of(*Settings.from_lines(lines).board())
        except (SettingError, ValueError):  # another version's settings
            return board_of(kind, self.number("wheels.diameter_m"), self.number("board.per_rps"))

    def joint(self, servo: int) -> str:
        """The name that the settings give it."""
        named = (key.split(".") for key, value in self.settings.items() if value == str(servo))
        return next((key[1] for key in named if key[0] == "joints" and key[2:] == ["servo"]), f"servo {servo}")

    def joints(self) -> dict[int, list[tuple[int, int]]]:
        """(when, pulses): where each servo of the arm was sent, by its number."""
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
    """One write to the port. `kind`: as box.pack_wire() recorded it; `ids`: the wheels' ids on the wire."""
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
    """A process, for people."""
    return process.replace("_", " ")

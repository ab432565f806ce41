"""Incident: a saved file, decoded into series over time. What can't be decoded is left out and counted."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import msgpack

from failstop.api.events import Event, unpack
from failstop.api.samples import ImuSample
from failstop.board import framing, servos
from failstop.board.interface import BOARD
from failstop.incidents import files, memory
from failstop.incidents.files import IncidentError
from failstop.policy import causes
from failstop.policy.settings import BY_KEY
from failstop.shm import box, layout, records

Payload = TypeVar("Payload")
MOTION, ZERO, PING, OTHER, STOP_BURST, REST = "motion", "zero", "ping", "other", "stop burst", "rest"
ARM = "arm"
"""What was written: a motor frame that moves a wheel, one of zeros, ..., the rest of what the kernel had not taken; ARM
is a frame for the arm's servos."""
SELF_NAMED = ("events", "buttons")
"""Rings whose entries name their parts, whatever the layout."""
_SPEEDS = struct.Struct(f"<6x{'Bf' * framing.WHEELS}")


class Tick(NamedTuple):
    """What the gate decided at one tick."""

    ns: int
    epoch: int
    block: str
    """A word of box.BLOCKS."""
    enabled: bool
    manual: bool
    drives: bool
    """The newest command is the one that drives."""
    commands: int
    """That came since the tick before."""
    age_us: int | None
    """Of the newest command; None: there was none yet."""
    command: tuple[float, float, float]
    """m/s forward, m/s left, rad/s counter-clockwise; may be anything, NaN too."""
    velocity: tuple[float, float, float]
    """What the gate made of it."""
    wheels_rps: tuple[float, float, float, float]
    source: str
    who: str


class Write(NamedTuple):
    """One write to the port."""

    ns: int
    by: str
    sort: str
    """MOTION, ZERO, PING, ARM, OTHER, STOP_BURST or REST."""
    length: int = 0
    taken: int = 0
    """Bytes that the kernel took at once."""
    head: bytes = b""
    """The frame's first bytes."""
    speeds_rps: tuple[float, ...] | None = None
    """The wheel speeds that it sets, by wire id; None: it sets none."""


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
        """Saved by a version that laid its records out otherwise: the head and the events, which name their parts, are
        read, and nothing else."""
        self.undecoded = 0
        self.ticks = [Tick(ns, **found) for ns, found in self._entries(layout.GATE, "box", box.unpack_gate)]
        """The gate's decisions."""
        supervisor = self._entries(layout.SUPERVISOR, "box", box.unpack_beats)
        self.beats = [(ns, times) for ns, times in supervisor if times]
        """(when, (silent_us, before_us) of each process: its longest silence since the sample before, and how long
        before this sample that was seen), as layout.PROCESSES."""
        wire = self._entries(layout.PORT_OWNER, "box", box.unpack_wire)
        last_ns = self.words(layout.STOPPER).get("written_ns", 0)
        writes = [_write(ns, layout.PORT_OWNER, *written) for ns, written in wire]
        writes += [_write(ns, layout.SUPERVISOR, box.BURST) for ns, times in supervisor if not times]
        writes += [_write(last_ns, layout.STOPPER, box.BURST)] * (last_ns > 0)
        self.writes = sorted(writes, key=lambda write: write.ns)
        """Everything for the board, in order: the port owner's, the supervisor's bursts, the stopper's last one."""
        board: list[tuple[int, tuple[int, Any]]] = self._entries(layout.TELEMETRY, "box", box.unpack_board)
        self.imu = [ImuSample(ns, values[:3], values[3:]) for ns, (kind, values) in board if kind == box.IMU]
        self.battery = [(ns, values[0], values[1]) for ns, (kind, values) in board if kind == box.BATTERY]
        """(when, millivolts, charger: an index of records.PLUGGED)."""
        servo = [(ns, values) for ns, (kind, values) in board if kind == box.SERVO]
        self.servo_positions = [(ns, v[0], v[3]) for ns, v in servo if v[1] == servos.POSITION and v[3]]
        """(when, servo, pulses): where servos said that they were. A 0, which a late answer makes of the next, is no
        place."""
        self.arm_goals = self._entries(layout.GATE, "arm_box", box.unpack_arm)
        """(when, (mode, who, aims)): what the arm was to do, ten times a second while somebody moved it."""
        self.received = self._entries(layout.PORT_OWNER, "received", bytes)
        """Bytes from the board, of the last seconds."""
        noticed = [
            (cause_ns, segment, causes.read(cause))
            for segment in (layout.PORT_OWNER, layout.GATE)
            for _, (_, cause_ns, _, cause) in self._entries(segment, "stops", records.STOPPED.unpack)
        ]
        self.stops = sorted(noticed, key=lambda stop: stop[0])
        """(when, by whom, cause): every cause that port owner and gate noticed."""
        told = [event for _, event in self._entries(layout.SUPERVISOR, "events", lambda payload: unpack(0, payload))]
        told += [
            Event(0, self.unix_ns(ns) / 1e9, ns, str(button["kind"]), "info", _pressed(button), {})
            for ns, button in self._entries(layout.TELEMETRY, "buttons", _map)
        ]
        self.events = sorted(told, key=lambda event: event.ns)
        """What people were told, and keys and pad buttons that the board sent."""
        times = [found[0] for series in (self.ticks, self.writes, self.imu, self.beats) for found in series]
        self.span_ns = min(times, default=self.cause_ns), max(times, default=self.cause_ns)
        """The oldest and the newest moment that is in the file."""

    @classmethod
    def read(cls, path: str) -> Incident:
        """Raises IncidentError."""
        head, body = files.read(path)
        try:
            return cls(files.identity(path), head, body)
        except (KeyError, TypeError) as error:
            raise IncidentError(f"{path} is no incident as failstop writes them ({error!r})") from None

    def _entries(self, segment: str, name: str, decode: Callable[[bytes], Payload | None]) -> list[tuple[int, Payload]]:
        """A ring's (when, what)."""
        found: list[tuple[int, Payload]] = []
        if self.foreign and name not in SELF_NAMED:
            return found
        for _, ns, payload in self._segments.get(segment, {}).get("rings", {}).get(name, []):
            if (entry := self._decoded(decode, payload)) is not None:
                found.append((ns, entry))
        return found

    def _decoded(self, decode: Callable[[bytes], Payload | None], payload: bytes) -> Payload | None:
        found = None
        with contextlib.suppress(ValueError, KeyError, TypeError, IndexError, msgpack.UnpackException):
            found = decode(payload)
        self.undecoded += found is None
        return found

    @property
    def why(self) -> str:
        """The reason without who asked for it; as the file has it, where this version knows no such cause."""
        return self.reason if self.cause.kind is causes.UNKNOWN else memory.short(self.cause)

    def check_layout(self) -> None:
        """Raise IncidentError for one whose records this version can't read."""
        if self.foreign:
            raise IncidentError(
                f"{self.id} is of failstop {self.head['versions']['failstop']}, whose records are laid out otherwise: "
                "use that version for this; `failstop incident show` has what was told"
            )

    def ms(self, ns: int) -> float:
        """Milliseconds from the cause."""
        return (ns - self.cause_ns) / 1e6

    def unix_ns(self, ns: int) -> int:
        """Wall time of a moment, in nanoseconds."""
        return int(ns + self.head["unix_minus_monotonic_ns"])

    def number(self, key: str) -> float:
        """A setting; its default where the file has none, or no number."""
        try:
            return float(self.settings[key])
        except (KeyError, ValueError):
            return float(BY_KEY[key].default)

    def words(self, segment: str) -> dict[str, int]:
        """The words of a segment."""
        return dict(self._segments.get(segment, {}).get("words", {}))

    def latest_map(self, segment: str, name: str) -> dict[str, Any]:
        """A record, a msgpack map, as it was when the file was saved; empty when there is none."""
        entry = self._segments.get(segment, {}).get("latest", {}).get(name)
        return (self._decoded(_map, entry[2]) if entry else None) or {}

    def processes(self) -> dict[str, dict[str, Any]]:
        """The process table as it was saved, with each one's heartbeat: pid, state, restarts, last_exit, beat_ns,
        worst_ms. The supervisor's own row has no state."""
        table = self.latest_map(layout.SUPERVISOR, "processes").get("processes", {})
        found = {}
        for name in layout.PROCESSES:
            words = self.words(name)
            row = {"pid": words.get("beat_pid", 0), "restarts": 0, "last_exit": None, **table.get(name, {})}
            beat = {"beat_ns": words.get("beat_ns", 0), "worst_ms": words.get("beat_worst_ns", 0) / 1e6}
            found[name] = row | beat
        return found


def _write(ns: int, by: str, kind: int, length: int = 0, taken: int = 0, head: bytes = b"") -> Write:
    """Of a kind of box.pack_wire."""
    speeds: tuple[float, ...] | None = None
    if kind == box.BURST:
        sort, speeds = STOP_BURST, (0.0,) * framing.WHEELS
    elif kind == box.REST:
        sort = REST
    elif head.startswith(framing.MOTOR_HEAD) and len(head) >= _SPEEDS.size:
        found = _SPEEDS.unpack_from(head)
        by_wheel = dict(zip(found[::2], found[1::2], strict=True))
        speeds = tuple(by_wheel.get(wheel, 0.0) for wheel in range(framing.WHEELS))
        sort = MOTION if any(speeds) else ZERO
    elif head[2:3] == bytes((framing.BUS_SERVO,)):
        sort = ARM
    else:
        sort = PING if head in BOARD.pings else OTHER
    return Write(ns, by, sort, length, taken, head, speeds)


def _map(payload: bytes) -> dict[str, Any]:
    found = msgpack.unpackb(payload)
    if not isinstance(found, dict):
        raise ValueError("no map")
    return found


def _pressed(button: dict[str, Any]) -> str:
    if button["kind"] == "pad":
        return str(causes.BUTTON(button["buttons"]))
    return f"key {button['key']}, event 0x{button['event']:02X}"

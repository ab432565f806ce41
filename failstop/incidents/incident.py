"""Incident: a saved file, decoded into series over time. What can't be decoded is left out and counted."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import msgpack

from failstop.board import framing
from failstop.board.interface import BOARD
from failstop.incidents import file, outcome
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.shm import box, layout, records

Payload = TypeVar("Payload")
MOTION, ZERO, PING, OTHER, STOP_BURST, REST = "motion", "zero", "ping", "other", "stop burst", "rest"
ARM = "arm"
"""What was written: a motor frame that moves a wheel, one of zeros, ..., the rest of what the kernel had not taken; ARM
is a frame for the arm's servos."""
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


@dataclass(frozen=True)
class Write:
    """One write to the port."""

    ns: int
    by: str
    kind: int
    """box.BURST, FRAME or REST."""
    length: int
    taken: int
    """Bytes that the kernel took at once."""
    head: bytes
    """The frame's first bytes."""

    @cached_property
    def speeds_rps(self) -> tuple[float, ...] | None:
        """The wheel speeds that it sets, by wire id; None: it sets none."""
        if self.kind == box.BURST:
            return (0.0,) * framing.WHEELS
        if self.kind == box.REST or not self.head.startswith(framing.MOTOR_HEAD) or len(self.head) < _SPEEDS.size:
            return None
        found = _SPEEDS.unpack_from(self.head)
        speeds = dict(zip(found[::2], found[1::2], strict=True))
        return tuple(speeds.get(wheel, 0.0) for wheel in range(framing.WHEELS))

    @cached_property
    def sort(self) -> str:
        """MOTION, ZERO, PING, ARM, OTHER, STOP_BURST or REST."""
        if self.kind in (box.BURST, box.REST):
            return STOP_BURST if self.kind == box.BURST else REST
        if self.speeds_rps is not None:
            return MOTION if any(self.speeds_rps) else ZERO
        if self.head[2:3] == bytes((framing.BUS_SERVO,)):
            return ARM
        return PING if self.head in BOARD.pings else OTHER


class Sample(NamedTuple):
    """One IMU sample, as published: m/s2, and rad/s less the bias."""

    ns: int
    acceleration_mps2: tuple[float, float, float]
    rate_radps: tuple[float, float, float]


class ArmGoal(NamedTuple):
    """What the arm was to do at a moment, as box.pack_arm."""

    ns: int
    mode: str
    """A word of box.ARM_MODES."""
    who: str
    aims: dict[int, float]


class Stop(NamedTuple):
    """A cause, as who noticed it put it into shared memory."""

    ns: int
    noticed_by: str
    cause: Cause


class Event(NamedTuple):
    """What people were told."""

    ns: int
    kind: str
    level: str
    text: str
    fields: dict[str, Any]


class Incident:
    """One file, whole. `ms(ns)` is relative to the cause."""

    def __init__(self, identity: str, head: dict[str, Any], body: dict[str, Any]) -> None:
        self.id = identity
        self.head = head
        self.cause_ns: int = head["cause_ns"]
        self.reason: str = head["reason"]
        name, arguments = head["cause"]["name"], {key: value for key, value in head["cause"].items() if key != "name"}
        self.cause = causes.of(name, arguments)
        self.settings: dict[str, str] = body["settings"]
        self.machine: dict[str, Any] = body["machine"]
        self._segments: dict[str, Any] = body["segments"]
        self.foreign = head["layout"] != layout.LAYOUT_VERSION
        """Saved by a version that laid its records out otherwise: the head and the events, which name their parts, are
        read, and nothing else."""
        self.undecoded = 0

    @classmethod
    def read(cls, path: str) -> Incident:
        """Raises IncidentError."""
        head, body = file.read(path)
        try:
            return cls(os.path.basename(path).removesuffix(file.SUFFIX), head, body)
        except (KeyError, TypeError) as error:
            raise file.IncidentError(f"{path} is no incident as failstop writes them ({error!r})") from None

    @property
    def why(self) -> str:
        """The reason without who asked for it; as the file has it, where this version knows no such cause."""
        return self.reason if self.cause.kind is causes.UNKNOWN else outcome.short(self.cause)

    def check_layout(self) -> None:
        """Raise IncidentError for one whose records this version can't read."""
        if self.foreign:
            raise file.IncidentError(
                f"{self.id} is of failstop {self.head['versions']['failstop']}, whose records are laid out otherwise: "
                "use that version for this; `failstop incident show` has what was told"
            )

    def ms(self, ns: int) -> float:
        """Milliseconds from the cause."""
        return (ns - self.cause_ns) / 1e6

    def unix_ns(self, ns: int) -> int:
        """Wall time of a moment, in nanoseconds."""
        return int(ns + self.head["unix_minus_monotonic_ns"])

    def number(self, key: str, default: float) -> float:
        """A setting; `default` for one that the file does not have, or that is no number."""
        try:
            return float(self.settings[key])
        except (KeyError, ValueError):
            return default

    def words(self, segment: str) -> dict[str, int]:
        """The words of a segment."""
        return dict(self._segments.get(segment, {}).get("words", {}))

    def latest_map(self, segment: str, name: str) -> dict[str, Any]:
        """A record, a msgpack map, as it was when the file was saved; empty when there is none."""
        entry = self._segments.get(segment, {}).get("latest", {}).get(name)
        return (self._decoded(_map, entry[2]) if entry else None) or {}

    def _ring(self, segment: str, name: str) -> list[list[Any]]:
        return list(self._segments.get(segment, {}).get("rings", {}).get(name, []))

    def _decoded(self, decode: Callable[[bytes], Payload], payload: bytes) -> Payload | None:
        try:
            return decode(payload)
        except (ValueError, KeyError, TypeError, IndexError, msgpack.UnpackException):
            self.undecoded += 1
            return None

    def _entries(self, segment: str, name: str, decode: Callable[[bytes], Payload]) -> Iterator[tuple[int, Payload]]:
        for _, ns, payload in () if self.foreign and decode not in (_map, _event) else self._ring(segment, name):
            if (found := self._decoded(decode, payload)) is not None:
                yield ns, found

    @cached_property
    def ticks(self) -> list[Tick]:
        """The gate's decisions."""
        return [Tick(ns, **found) for ns, found in self._entries(layout.GATE, "box", box.unpack_gate)]

    @cached_property
    def writes(self) -> list[Write]:
        """Everything for the board, in order: the port owner's, the supervisor's bursts, the stopper's last one."""
        found = [
            Write(ns, layout.PORT_OWNER, *written)
            for ns, written in self._entries(layout.PORT_OWNER, "box", box.WIRE.unpack)
        ]
        for ns, ages in self._entries(layout.SUPERVISOR, "box", box.unpack_beats):
            if not ages:
                found.append(Write(ns, layout.SUPERVISOR, box.BURST, 0, 0, b""))
        if last_ns := self.words(layout.STOPPER).get("written_ns"):
            found.append(Write(last_ns, layout.STOPPER, box.BURST, 0, 0, b""))
        return sorted(found, key=lambda write: write.ns)

    @cached_property
    def _board(self) -> list[tuple[int, tuple[int, tuple[Any, ...]]]]:
        return list(self._entries(layout.TELEMETRY, "box", box.unpack_board))

    def _of_board(self, wanted: int) -> list[tuple[int, tuple[Any, ...]]]:
        return [(ns, values) for ns, (kind, values) in self._board if kind == wanted]

    @cached_property
    def imu(self) -> list[Sample]:
        """Every sample."""
        return [Sample(ns, values[:3], values[3:]) for ns, values in self._of_board(box.IMU)]

    @cached_property
    def battery(self) -> list[tuple[int, int, str]]:
        """(when, millivolts, charger)."""
        return [(ns, values[0], records.PLUGGED[values[1]]) for ns, values in self._of_board(box.BATTERY)]

    @cached_property
    def arm_goals(self) -> list[ArmGoal]:
        """What the arm was to do: ten times a second while somebody moved it."""
        return [ArmGoal(ns, *found) for ns, found in self._entries(layout.GATE, "arm_box", box.unpack_arm)]

    @cached_property
    def servo_answers(self) -> list[tuple[int, int, int, int | None]]:
        """(when, servo, what was asked, its answer; None: it had none), as decoder.servo_reply."""
        return [(ns, servo, what, value) for ns, (servo, what, value) in self._of_board(box.SERVO)]

    @cached_property
    def beats(self) -> list[tuple[int, tuple[tuple[int, int], ...]]]:
        """(when, (silent_us, before_us) of each process: its longest silence since the sample before, and how long
        before this sample that was seen), as layout.PROCESSES."""
        return [(ns, ages) for ns, ages in self._entries(layout.SUPERVISOR, "box", box.unpack_beats) if ages]

    @cached_property
    def received(self) -> list[tuple[int, bytes]]:
        """Bytes from the board, of the last seconds."""
        return [(ns, payload) for _, ns, payload in self._ring(layout.PORT_OWNER, "received")]

    @cached_property
    def stops(self) -> list[Stop]:
        """Every cause that port owner and gate noticed."""
        found = []
        for segment in (layout.PORT_OWNER, layout.GATE):
            for _, (_, cause_ns, _, cause) in self._entries(segment, "stops", records.STOPPED.unpack):
                found.append(Stop(cause_ns, segment, causes.read(cause)))
        return sorted(found, key=lambda stop: stop.ns)

    @cached_property
    def events(self) -> list[Event]:
        """What people were told, and keys and pad buttons that the board sent."""
        found = []
        for ns, event in self._entries(layout.SUPERVISOR, "events", _event):
            found.append(Event(event.get("ns", ns), event["kind"], event["level"], event["text"], event["fields"]))
        for ns, event in self._entries(layout.TELEMETRY, "buttons", _map):
            found.append(Event(ns, str(event["kind"]), "info", _button(event), {}))
        return sorted(found, key=lambda event: event.ns)

    def processes(self) -> dict[str, dict[str, Any]]:
        """The process table as it was saved, with each one's heartbeat: pid, state, restarts, last_exit, beat_ns,
        worst_ms. The supervisor's own row has no state."""
        table = self.latest_map(layout.SUPERVISOR, "processes").get("processes", {})
        found = {}
        for name in layout.PROCESSES:
            words = self.words(name)
            row = {"pid": words.get("beat_pid", 0), "restarts": 0, "last_exit": None, **table.get(name, {})}
            row["beat_ns"] = words.get("beat_ns", 0)
            row["worst_ms"] = words.get("beat_worst_ns", 0) / 1e6
            found[name] = row
        return found

    def span_ns(self) -> tuple[int, int]:
        """The oldest and the newest moment that is in the file."""
        times = [tick.ns for tick in self.ticks] + [write.ns for write in self.writes]
        times += [sample.ns for sample in self.imu] + [ns for ns, _ in self.beats]
        return min(times, default=self.cause_ns), max(times, default=self.cause_ns)


def _map(payload: bytes) -> dict[str, Any]:
    found = msgpack.unpackb(payload)
    if not isinstance(found, dict):
        raise ValueError("no map")
    return found


def _event(payload: bytes) -> dict[str, Any]:
    found = _map(payload)
    for key in ("kind", "level", "text"):
        if not isinstance(found[key], str):
            raise ValueError(f"{key} is no text")
    return found


def _button(event: dict[str, Any]) -> str:
    if event["kind"] == "pad":
        return str(causes.BUTTON(event["buttons"]))
    return f"key {event['key']}, event 0x{event['event']:02X}"

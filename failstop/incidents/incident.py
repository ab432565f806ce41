"""Incident: a saved file, decoded into series over time, and what is computed from these. What can't be decoded is left
out and counted."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar

from failstop.api.events import Event, unpack
from failstop.api.snapshot import Imu
from failstop.board import framing, servos
from failstop.board.interface import BOARD
from failstop.incidents import files, memory
from failstop.incidents.files import IncidentError
from failstop.policy import causes
from failstop.policy.processes import BY_NAME
from failstop.policy.settings import BY_KEY
from failstop.procs.telemetry.still import HOLD_NS, WINDOW_NS, StillJudge
from failstop.shm import blocks, box, layout, records

Payload = TypeVar("Payload")
Points = list[tuple[int, float]]
"""When (CLOCK_MONOTONIC ns), and a value."""
FIRST_NS = WINDOW_NS + HOLD_NS
"""Nothing can be still sooner."""
WHEELS = ("front left", "rear left", "front right", "rear right")
MOVES_AT = 8
"""Where the first servo of a move stands in its frame."""
DRIVING = "driving"
SILENT = "silent"
SAYS = {
    DRIVING: "the wheels may turn",
    "estop": "a stop is latched",
    blocks.DISABLED: "motion is disabled",
    blocks.NO_COMMAND: "no command",
    blocks.NO_SCAN: "no obstacle sensor",
    SILENT: "the gate is silent",
}
"""What the gate says, or that it says nothing, for people."""
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


class Sort:
    """What was written: a motor frame that moves a wheel, one of zeros, a frame for the arm's servos, ..., the rest of
    what the kernel had not taken."""

    MOTION, ZERO, ARM, PING, OTHER, STOP_BURST, REST = "motion", "zero", "arm", "ping", "other", "stop burst", "rest"


class Write(NamedTuple):
    """One write to the port."""

    ns: int
    by: str
    sort: str
    """Of Sort."""
    length: int = 0
    taken: int = 0
    """Bytes that the kernel took at once."""
    head: bytes = b""
    """The frame's first bytes."""
    speeds_rps: tuple[float, ...] | None = None
    """The speeds that it sets, as WHEELS; None: it sets none."""


class Silence(NamedTuple):
    """A process that did not beat for longer than it should."""

    process: str
    since_ns: int
    """Its last beat before."""
    until_ns: int
    """When it was last seen to be silent."""
    ended: bool
    """It beat again, within what is saved."""


class Joint(NamedTuple):
    """One servo of the arm over time, in pulses."""

    servo: int
    name: str
    """Of the settings; empty: they name none."""
    sent: Points
    """Where it was sent."""
    read: Points
    """Where it said that it was."""
    goals: Points
    """Where it was to be, of trajectories (their ends) and follow; a rate is no place."""


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
        wire = self._entries(layout.PORT_OWNER, "box", box.WIRE.unpack)
        last_ns = self.words(layout.STOPPER).get("written_ns", 0)
        ids = [int(self.number(f"wheels.id_{number}")) for number in (1, 2, 3, 4)]
        writes = [_write(ids, ns, layout.PORT_OWNER, *written) for ns, written in wire]
        writes += [_write(ids, ns, layout.SUPERVISOR, box.BURST) for ns, times in supervisor if not times]
        writes += [_write(ids, last_ns, layout.STOPPER, box.BURST)] * (last_ns > 0)
        self.writes = sorted(writes, key=lambda write: write.ns)
        """Everything for the board, in order: the port owner's, the supervisor's bursts, the stopper's last one."""
        board: list[tuple[int, tuple[int, Any]]] = self._entries(layout.TELEMETRY, "box", box.unpack_board)
        self.imu = [Imu(ns, values[:3], values[3:]) for ns, (kind, values) in board if kind == box.IMU]
        self.battery = [(ns, values[0], values[1]) for ns, (kind, values) in board if kind == box.BATTERY]
        """(when, millivolts, charger: an index of records.PLUGGED)."""
        servo = [(ns, values) for ns, (kind, values) in board if kind == box.SERVO]
        self.servo_positions = [(ns, v[0], v[2]) for ns, v in servo if v[1] == servos.POSITION and v[2]]
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
        for ns, (kind, text) in self._entries(layout.TELEMETRY, "buttons", _button):
            told.append(Event(0, self.unix_ns(ns) / 1e9, ns, kind, "info", text, {}))
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
        # Their entries name their parts, whatever the layout.
        if self.foreign and name not in ("events", "buttons"):
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
        return memory.as_map(entry[2]) if entry else {}

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

    def verdicts(self) -> list[tuple[int, bool]]:
        """(when it was found, still or not) at each change of telemetry's judgement on the wheels, judged again."""
        judge = StillJudge(self.number("still.std_radps"))
        found: list[tuple[int, bool]] = []
        for sample in self.imu:
            judge.take(sample.rate_radps[0], sample.rate_radps[1], sample.t_ns)
            still = judge.still_ns > 0
            if judge.judged_ns and sample.t_ns - self.imu[0].t_ns >= FIRST_NS and (not found or found[-1][1] != still):
                found.append((sample.t_ns, still))
        return found

    def proven(self) -> dict[str, Any] | None:
        """How the stop was proven, as of memory.told_stop. Where the supervisor saw no shaking, since it was held up
        itself, the samples' word on when the wheels came to rest."""
        stop: dict[str, Any] | None = self.head["stop"]
        if stop is None or stop.get("observed_ms") or stop.get("wheels") == "unstill":
            return stop
        found = self.verdicts()
        turned = [still for ns, still in found if ns <= self.cause_ns][-1:] == [False]
        rested = [ns for ns, still in found if still and ns > self.cause_ns]
        # It is found so much later than it was.
        seen = {"observed_ms": max(1.0, self.ms(rested[0] - FIRST_NS))} if turned and rested else {}
        return stop | seen

    def allowed_ns(self, process: str) -> int:
        """How long a process may be silent without anybody minding."""
        if process in (layout.GATE, layout.SUPERVISOR):
            return round(self.number("gate.lease_s") * 1e9)
        return BY_NAME[process].deadline_ns

    def silences(self) -> list[Silence]:
        """Every silence that the supervisor saw, the oldest first; of its own, those that it noticed afterwards."""
        found = []
        for index, process in enumerate(layout.PROCESSES):
            beats = [(ns, *times[index]) for ns, times in self.beats]
            allowed = self.allowed_ns(process)
            seen = [(us * 1000 > allowed, ns - before_us * 1000, us * 1000) for ns, us, before_us in beats]
            for late, run in ((late, list(group)) for late, group in groupby(seen, itemgetter(0))):
                if late:
                    found.append(Silence(process, run[0][1] - run[0][2], run[-1][1], ended=run[-1] is not seen[-1]))
        return sorted(found, key=lambda silence: silence.since_ns)

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

    def joints(self) -> list[Joint]:
        """Each servo that was sent somewhere or read, by its number."""
        parts = ((key.split("."), value) for key, value in self.settings.items())
        names = {int(value): key[1] for key, value in parts if key[0] == "joints" and key[2:] == ["servo"]}
        found: dict[int, Joint] = {}

        def of(servo: int) -> Joint:
            return found.setdefault(servo, Joint(servo, names.get(servo, ""), [], [], []))

        for write in self.writes:
            head = write.head
            if write.taken and len(head) > MOVES_AT and head[2] == framing.BUS_SERVO and head[4] == servos.MOVE:
                for at in range(MOVES_AT, min(MOVES_AT + 3 * head[7], len(head) - 3), 3):
                    of(head[at]).sent.append((write.ns, head[at + 1] | head[at + 2] << 8))
        for ns, servo, pulses in self.servo_positions:
            of(servo).read.append((ns, pulses))
        for ns, (mode, _, aims) in self.arm_goals:
            for servo, aim in aims.items() if mode in ("trajectory", "follow") else ():
                of(servo).goals.append((ns, aim))
        return sorted(found.values())


def _write(ids: list[int], ns: int, by: str, kind: int, length: int = 0, taken: int = 0, head: bytes = b"") -> Write:
    """Of a kind of box.pack_wire; `ids`: on the wire, of WHEELS."""
    speeds: tuple[float, ...] | None = None
    if kind == box.BURST:
        sort, speeds = Sort.STOP_BURST, (0.0,) * framing.WHEELS
    elif kind == box.REST:
        sort = Sort.REST
    elif head.startswith(framing.MOTOR_HEAD) and len(head) >= _SPEEDS.size:
        found = _SPEEDS.unpack_from(head)
        by_id = dict(zip(found[::2], found[1::2], strict=True))
        speeds = tuple(by_id.get(wire_id, 0.0) for wire_id in ids)
        sort = Sort.MOTION if any(speeds) else Sort.ZERO
    elif head[2:3] == bytes((framing.BUS_SERVO,)):
        sort = Sort.ARM
    else:
        sort = Sort.PING if head in BOARD.pings else Sort.OTHER
    return Write(ns, by, sort, length, taken, head, speeds)


def _button(payload: bytes) -> tuple[str, str]:
    """Its kind and its text: a key, or buttons of the gamepad."""
    found = memory.as_map(payload)
    if found["kind"] == "pad":
        return "pad", str(causes.BUTTON(found["buttons"]))
    return str(found["kind"]), f"key {found['key']}, event 0x{found['event']:02X}"

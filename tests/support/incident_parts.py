"""Incidents made by hand: each record as its writer packs it, at milliseconds from the cause."""

from __future__ import annotations

from math import nan
from pathlib import Path
from typing import Any

import msgpack

from failstop.board.rrc.board import BOARD
from failstop.cli import style
from failstop.incidents import files
from failstop.incidents.incident import Incident
from failstop.messages import box, layout, records
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.kinematics import from_settings
from failstop.policy.settings import FIRST_SOURCE, Settings
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.rings import GateBox
from failstop.procs.gate.sources import Command

CAUSE_NS = 5_000_000_000_000
UNIX_NS = 1_790_000_000_000_000_000
GATE_DIED = causes.DIED(layout.GATE)
RATE_STILL, RATE_MOVING = 0.002, 0.006


def at(ms: float) -> int:
    return CAUSE_NS + round(ms * 1e6)


def printed(lines: list[style.Line]) -> str:
    return "\n".join(map(style.plain, lines))


class KeptRing:
    """A ring's writer that only keeps what is put."""

    def __init__(self) -> None:
        self.entries: list[list[Any]] = []

    def put(self, payload: bytes, t_ns: int | None = None) -> int:
        assert t_ns is not None
        self.entries.append([len(self.entries) + 1, t_ns, payload])
        return len(self.entries)


class Recorder:
    """Memory as a run leaves it; incident() or save() make a file of it."""

    def __init__(self, cause: Cause = GATE_DIED, kind: str = "stop", settings: dict[str, object] | None = None) -> None:
        self.why = cause
        self.kind = kind
        self.stop: dict[str, Any] | None = {"written_by": "port owner", "noticed_by": "port_owner", "written_us": 212.0}
        self.stop |= {"acknowledged_us": 3100.0, "observed_ms": 320.0}
        self.rings: dict[tuple[str, str], KeptRing] = {}
        self.last_beats_ms: dict[str, float] = {}
        """The last beat of each process that is not there at the end."""
        self.settings = Settings({"device.path": "/dev/pts/7", **(settings or {})})
        self.core = GateCore(self.settings, from_settings(self.settings), 0)
        self.gate = GateBox(self.ring(layout.GATE, "box"))  # type: ignore[arg-type]

    def ring(self, segment: str, name: str) -> KeptRing:
        return self.rings.setdefault((segment, name), KeptRing())

    def command(
        self,
        ms: float,
        velocity: tuple[float, float, float],
        who: str = "nav (pid 77)",
        source: str = FIRST_SOURCE,
        session: int = 1,
    ) -> None:
        command = Command(session, who, at(ms), velocity, source=source)
        self.core.accept(command, at(ms))
        self.gate.command(command)

    def tick(self, ms: float) -> None:
        self.core.step(at(ms))
        self.gate.tick(at(ms), self.core, 7)

    def frame(self, ms: float, data: bytes, taken: int | None = None) -> None:
        payload = box.pack_wire(box.WIRE_FRAME, data, len(data) if taken is None else taken)
        self.ring(layout.PORT_OWNER, "box").put(payload, at(ms))

    def burst(self, ms: float) -> None:
        size = len(BOARD.burst)
        self.ring(layout.PORT_OWNER, "box").put(box.pack_wire(box.WIRE_BURST, BOARD.burst, size), at(ms))

    def imu(self, ms: float, spread: float) -> None:
        """One sample whose gyro is up or down by `spread` rad/s in turn."""
        ring = self.ring(layout.TELEMETRY, "box")
        rate = spread if len(ring.entries) % 2 else -spread
        ring.put(box.pack_board(box.IMU_KIND, 0.1, 0.2, 9.8, rate, -rate, 0.01), at(ms))

    def wheels(self, ms: float, *speeds_rps: float) -> None:
        """A report of the wheels' measured speeds, by wire id."""
        given = (*speeds_rps, *[nan] * records.MOST_WHEELS)[: records.MOST_WHEELS]
        self.ring(layout.TELEMETRY, "box").put(box.pack_board(box.WHEELS_KIND, *given), at(ms))

    def beats(self, ms: float, **ages_ms: float) -> None:
        ages = [round(ages_ms.get(process, 5.0) * 1000) for process in layout.PROCESS_NAMES]
        self.ring(layout.SUPERVISOR, "box").put(box.pack_beats(ages, [1000] * len(ages)), at(ms))

    def event(self, ms: float, kind: str, text: str, level: str = "notice", *, step: str = "", **fields: Any) -> None:
        event = {"t": 0.0, "ns": at(ms), "kind": kind, "level": level, "text": text, "fields": fields}
        if step:
            event |= {"text": f"{text}; next: {step}", "what": len(text)}
        self.ring(layout.SUPERVISOR, "events").put(msgpack.packb(event), at(ms))

    def cause(self, ms: float, cause: Cause) -> None:
        payload = records.STOPPED.pack(7, at(ms), at(ms + 0.2), cause.pack())
        self.ring(layout.PORT_OWNER, "stops").put(payload, at(ms))

    def head(self, name: str = "failstop", unix_ns: int = UNIX_NS) -> dict[str, Any]:
        head: dict[str, Any] = {"name": name, "t": unix_ns / 1e9, "saved": unix_ns / 1e9 + 2.2, "host": "robot"}
        head |= {"reason": str(self.why), "cause": self.why.as_map(), "cause_ns": CAUSE_NS, "kind": self.kind}
        head |= {"unix_minus_monotonic_ns": unix_ns - CAUSE_NS, "layout": layout.LAYOUT_VERSION}
        head |= {"epoch": 7, "stop": self.stop}
        versions = {"failstop": "0.1.0", "python": "3.11.7", "kernel": "6.1", "machine": "aarch64"}
        return {**head, "run": "0123456789abcdef", "versions": versions}

    def body(self) -> dict[str, Any]:
        segments: dict[str, Any] = {}
        for index, name in enumerate(layout.PROCESS_NAMES):
            words = {"beat_pid": 100 + index, "beat_ns": at(self.last_beats_ms.get(name, 2190))}
            words |= {"beat_worst_ns": 21_000_000, "written_ns": 0}
            rings = {ring: kept.entries for (segment, ring), kept in self.rings.items() if segment == name}
            segments[name] = {"words": words, "latest": {}, "rings": rings}
        settings = dict(line.split("=", 1) for line in self.settings.lines().splitlines())
        machine = {"cores": 4, "load": "0.50 0.40 0.30"}
        return {"segments": segments, "settings": settings, "machine": machine}

    def incident(self, identity: str = "20260921-143320-gate-died") -> Incident:
        return Incident(identity, self.head(), self.body())

    def save(self, folder: Path, identity: str, name: str = "failstop", unix_ns: int = UNIX_NS) -> Path:
        return Path(files.write(str(folder), identity, files.build(self.head(name, unix_ns), self.body())))


def drive_and_die() -> Recorder:
    """The gate dies at 0.2 m/s, after 3 s of driving; the wheels are seen still 0.7 s later."""
    made = Recorder()
    made.core.enable(7, "", at(-3000))
    made.core.scan.deliver(at(0), at(0))
    made.event(-3000, "enabled", "motion enabled by nav (pid 77)")
    for ms in range(-3000, 0, 20):
        made.core.scan.deliver(at(ms), at(ms))
        made.command(ms, (0.2, 0.0, 0.0))
        made.tick(ms + 1)
        made.frame(ms + 1.1, BOARD.motor_speeds(made.core.speeds, 5.0))
    for ms in range(-2900, 2200, 500):
        made.frame(ms, BOARD.pings[0])
    for burst_ms in (0.2, 20.2, 100.2):
        made.burst(burst_ms)
    for ms in range(200, 2200, 200):
        made.frame(ms, BOARD.stop)
    for ms in range(-3000, 2200, 9):
        made.imu(ms, RATE_MOVING if ms < 80 else RATE_STILL)
    for ms in range(-3000, 2200, 100):
        made.beats(ms, gate=190.0 if ms == 200 else 90.0 if ms == 100 else 5.0)
    made.cause(0, GATE_DIED)
    latched = "STOP latched: gate died; stop frame written by the port owner after 212 us"
    made.event(0.5, "stop", latched, "warning", cause="died")
    made.event(1.0, "died", "gate (pid 102) was killed by SIGKILL", "error", process="gate", pid=102)
    return made

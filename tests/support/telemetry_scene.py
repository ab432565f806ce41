"""A stage for telemetry, run turn by turn inside the test: real segments and bells, a clock that the test moves, the
test in the roles of board, port owner and gate. The context that telemetry is given is this object."""

from __future__ import annotations

import itertools
import os
import struct
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.board import framing
from failstop.policy.settings import Settings
from failstop.procs.telemetry.main import Telemetry
from failstop.procs.world import World
from failstop.shm import layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import Heartbeat
from failstop.shm.packing import Note
from failstop.shm.segment import Segment
from tests.support.waiting import until

MS = 1_000_000
S = 1_000 * MS
INCARNATION = 0x7E1E
DEADLINE_S = 20.0
NOON = 1_773_662_400.0
"""2026-03-16 12:00:00 UTC."""
_numbers = itertools.count()


class Scene:
    """Telemetry at work; `turn` moves the clock, publishes the gate's state and wakes it up."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch, **changed: object) -> None:
        self.instance = f"telemetry-{os.getpid()}-{next(_numbers)}"
        self.now_ns = 50_000 * S
        self.world = World(now_ns=lambda: self.now_ns, unix_s=lambda: NOON)
        for spec in layout.SEGMENTS:
            segment.create(self.instance, spec.name, INCARNATION).close()
        self.folder = directory / "state"
        self.settings = Settings({"battery.directory": str(self.folder), **changed})
        self.own = self.owned(layout.TELEMETRY)
        self.heartbeat = Heartbeat(self.own, os.getpid(), 0, self.now_ns)
        self._received = self.owned(layout.PORT_OWNER).ring_writer("received")
        self._gate = self.owned(layout.GATE).latest_writer("state")
        self._bells = {name: EventBell.create() for name in ("bell", "port_owner_bell", "gate_bell", "supervisor_bell")}
        self.gate: dict[str, Any] = {"enabled": False, "estop": None, "epoch": 1, "body_vel": [0.0, 0.0, 0.0]}
        self._readers = {name: self.own.ring_reader(name) for name in ("causes", "pad_requests", "notes", "buttons")}
        self.telemetry: Telemetry
        self.start()

    # What Context offers.

    def bell(self, key: str) -> EventBell:
        return self._bells[key]

    def segment(self, name: str) -> Segment:
        return segment.attach(self.instance, name, INCARNATION)

    # The rest of the service.

    def owned(self, name: str) -> Segment:
        return segment.attach(self.instance, name, INCARNATION, write=True)

    def start(self) -> None:
        """Telemetry starts, or starts again after its death."""
        if hasattr(self, "telemetry"):
            self._end_thread()
        self.telemetry = Telemetry(self)  # type: ignore[arg-type]

    def turn(self, *frames: tuple[int, bytes], elapsed_ns: int = 0, gate: bool = True) -> None:
        """Time passes, the board sends frames, telemetry wakes up."""
        self.now_ns += elapsed_ns
        if gate:
            self._gate.write(msgpack.packb(self.gate), self.now_ns)
        if frames:
            self._received.put(b"".join(framing.frame(func, data) for func, data in frames), self.now_ns)
            self._bells["bell"].ring()
        self.telemetry.turn(self.telemetry.loop.wait(0))

    def imu(self, *raw: float, elapsed_ns: int = 9 * MS) -> None:
        """One sample: g on x, y, z and deg/s on x, y, z."""
        self.turn((framing.IMU, struct.pack("<6f", *raw)), elapsed_ns=elapsed_ns)

    def stand(self, seconds: float, z_dps: float = 0.25) -> None:
        """Samples of a robot at rest."""
        for _ in range(round(seconds * 1000 / 9)):
            self.imu(0.0, 0.0, 1.0, 0.0, 0.0, z_dps)

    def pad(self, buttons: int = 0, lx: int = 0, ly: int = 0, rx: int = 0) -> None:
        self.turn((framing.GAMEPAD, struct.pack("<HB4b", buttons, 0, lx, ly, rx, 0)), elapsed_ns=50 * MS)

    def key(self, key: int, event: int) -> None:
        self.turn((framing.KEY, bytes((key, event))))

    def battery(self, *millivolts: int) -> None:
        for mv in millivolts:
            self.turn((framing.SYS, struct.pack("<BH", 4, mv)), elapsed_ns=1_050 * MS)

    # What telemetry has told.

    def latest(self, name: str) -> bytes | None:
        entry = self.own.latest_reader(name).read()
        return entry[2] if entry else None

    def bias(self) -> tuple[tuple[float, float, float], bool, bool]:
        x, y, z, tracking, calibrated = records.BIAS.unpack(self.latest("bias") or b"")
        return (x, y, z), tracking, calibrated

    def commands(self) -> int:
        """How many pad commands were written."""
        entry = self.own.latest_reader("pad_command").read()
        return entry[0] if entry else 0

    def told(self, ring: str) -> list[bytes]:
        """New entries of a ring of telemetry's."""
        found = []
        while entry := self._readers[ring].next():
            found.append(entry[2])
        return found

    def notes(self) -> list[str]:
        return [Note.unpack(note).text for note in self.told("notes")]

    def rung(self, name: str) -> bool:
        """Whether a bell was rung; clears it."""
        try:
            return bool(os.read(self._bells[name].fd, 8))
        except BlockingIOError:
            return False

    def _end_thread(self) -> None:
        files = self.telemetry._files
        files.close()
        until(lambda: not files.running, "the end of the thread that writes files")

    def close(self) -> None:
        self._end_thread()
        for found in self._bells.values():
            os.close(found.fd)
        segment.unlink_all(self.instance)

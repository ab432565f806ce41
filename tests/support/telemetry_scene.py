"""Telemetry on a stage."""

from __future__ import annotations

import struct
from typing import Any

import msgpack

from failstop.board.rrc import framing
from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.procs.telemetry import main
from tests.support.stage import MS, Stage

S = 1_000 * MS
NOON_S = 1_773_662_400
"""2026-03-16 12:00:00 UTC."""
FOLDER = "/state"
"""The folder of telemetry's files; not there at first."""


class Scene(Stage):
    """Telemetry at work on its stage, in front of a board and a gate that the test plays, with a client."""

    def __init__(self, **changed: object) -> None:
        super().__init__(layout.TELEMETRY, open_port=True, **{"battery.directory": FOLDER, **changed})
        self.machine.unix_ns = NOON_S * S - self.clock()
        self.views[layout.GATE].word("busy").set(1)
        self._gate = self.views[layout.GATE].latest_writer("state")
        self.gate: dict[str, Any] = {"enabled": False, "estop": None, "epoch": 1, "body_vel": [0.0, 0.0, 0.0]}
        self.gate["wheels_rps"] = [0.0] * 4
        self._readers = {name: self.own.ring_reader(name) for name in ("causes", "pad_requests", "notes")}
        self.start_telemetry()

    def start_telemetry(self) -> None:
        self.telemetry = self.load("failstop.procs.telemetry.main").Telemetry(self)

    def turn(self, *frames: tuple[int, bytes], elapsed_ns: int = 0, gate: bool = True) -> None:
        """Time passes, the board sends frames, telemetry wakes up; `gate`: the gate publishes its state before."""
        while elapsed_ns > main.LONGEST_IDLE_NS:
            elapsed_ns -= main.LONGEST_IDLE_NS
            self.wake(elapsed_ns=main.LONGEST_IDLE_NS, gate=gate)
        self.wake(b"".join(framing.frame(func, data) for func, data in frames), elapsed_ns=elapsed_ns, gate=gate)

    def wake(self, data: bytes = b"", *, elapsed_ns: int = 0, gate: bool = True) -> None:
        """As turn(), with bytes of the board, and with no wake-up before."""
        self.clock.now_ns += elapsed_ns
        if gate:
            self._gate.write(msgpack.packb(self.gate), self.clock())
        self.wire.port.send(data)
        self.telemetry.turn(self.telemetry.loop.wait(0))

    def imu(self, *raw: float, elapsed_ns: int = 9 * MS) -> None:
        """One sample: g on x, y, z and deg/s on x, y, z."""
        self.turn((framing.IMU_FUNC, struct.pack("<6f", *raw)), elapsed_ns=elapsed_ns)

    def stand(self, seconds: float, z_dps: float = 0.25) -> None:
        for _ in range(round(seconds * 1000 / 9)):
            self.imu(0.0, 0.0, 1.0, 0.0, 0.0, z_dps)

    def pad(self, buttons: int = 0, lx: int = 0, ly: int = 0, rx: int = 0, *, times: int = 1) -> None:
        for _ in range(times):
            self.turn((framing.GAMEPAD, struct.pack("<HB4b", buttons, 0, lx, ly, rx, 0)), elapsed_ns=50 * MS)

    def key(self, key: int, event: int) -> None:
        self.turn((framing.KEY_FUNC, bytes((key, event))))

    def battery(self, *millivolts: int) -> None:
        for mv in millivolts:
            self.turn((framing.SYS, struct.pack("<BH", 4, mv)), elapsed_ns=1_050 * MS)

    # What telemetry has told.

    def latest(self, name: str) -> tuple[Any, ...]:
        """The values of a record; none before it is written."""
        entry = self.own.latest_reader(name).read()
        return tuple(getattr(records, name.upper()).unpack(entry[2])) if entry else ()

    def bias(self) -> tuple[tuple[float, float, float], bool, bool]:
        """Bias in rad/s, whether it is tracking, whether it is calibrated."""
        x, y, z, tracking, calibrated = self.latest("bias")
        return (x, y, z), tracking, calibrated

    def commands(self) -> int:
        entry = self.own.latest_reader("pad_command").read()
        return entry[0] if entry else 0

    def told(self, ring: str) -> list[bytes]:
        found = []
        while entry := self._readers[ring].next():
            found.append(entry[2])
        return found

    def requests(self) -> list[tuple[int, bytes]]:
        """New requests of the pad: what for, and a frame."""
        return [records.PAD_REQUEST.unpack(request) for request in self.told("pad_requests")]

    def notes(self) -> list[str]:
        return [Note.unpack(note).text for note in self.told("notes")]

    def rung(self, name: str) -> bool:
        """True where a bell was rung; clears it."""
        try:
            return bool(self.os.read(self.bell(name).fd, 8))
        except BlockingIOError:
            return False

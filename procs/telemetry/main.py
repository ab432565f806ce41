"""Telemetry's loop: bytes from the port owner's ring, decoded, published; buttons and keys become stop requests."""

from __future__ import annotations

from math import pi
from time import monotonic_ns

import msgpack

from failstop.board import decoder, framing
from failstop.procs import rights
from failstop.procs.loop import READ, Loop
from failstop.procs.telemetry.trips import Trips
from failstop.shm import bell, heartbeat, records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.context import Context

TICK_NS = 50_000_000
G_MPS2 = 9.80665
RAD_PER_DEG = pi / 180


class Telemetry:
    """The process's state; one turn() a wake-up."""

    def __init__(self, context: Context) -> None:
        settings = context.settings
        own = context.own
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self._epoch_word = context.segment("supervisor").word("epoch")
        self._received = context.segment("port_owner").ring_reader("received")
        self._imu = own.latest_writer("imu")
        self._battery = own.latest_writer("battery")
        self._pad = own.latest_writer("pad")
        self._events = own.ring_writer("events")
        self._stop_pipe = context.fd("stop")
        self._bell = context.bell("bell")
        self.supervisor_bell = context.bell("supervisor_bell")
        self._decoder = decoder.Decoder()
        self._trips = Trips(int(settings["pad.mode_button"]), int(settings["key.stop"]))
        self._handlers = {
            framing.IMU: self._on_imu,
            framing.SYS: self._on_system,
            framing.GAMEPAD: self._on_pad,
            framing.KEY: self._on_key,
        }
        self.loop.watch(self._bell.fd, READ)

    def turn(self, ready: dict[int, int]) -> None:
        """Handle one wake-up."""
        if ready:
            self._bell.clear()
        while entry := self._received.next():
            for func, data in self._decoder.feed(entry[2]):
                if handler := self._handlers.get(func):
                    handler(data, entry[1])
        self.heartbeat.beat(monotonic_ns(), self._epoch_word.get())

    def _request_stop(self, reason: str) -> None:
        """By the same pipe as everyone else: the port owner stops before anyone decides anything."""
        if reason:
            bell.send(self._stop_pipe, reason.encode() + b"\n")

    def _on_imu(self, data: bytes, t_ns: int) -> None:
        if sample := decoder.imu(data):
            ax, ay, az, gx, gy, gz = sample
            acceleration = (ax * G_MPS2, ay * G_MPS2, az * G_MPS2)
            self._imu.write(
                records.pack_imu(acceleration, (gx * RAD_PER_DEG, gy * RAD_PER_DEG, gz * RAD_PER_DEG)), t_ns
            )

    def _on_system(self, data: bytes, t_ns: int) -> None:
        if millivolts := decoder.battery_mv(data):
            self._battery.write(records.pack_battery(millivolts), t_ns)

    def _on_pad(self, data: bytes, t_ns: int) -> None:
        if sample := decoder.gamepad(data):
            reason = self._trips.pad(sample[0])
            self._request_stop(reason)
            self._pad.write(records.pack_pad(*sample), t_ns)
            if reason:
                self._events.put(msgpack.packb({"kind": "pad", "buttons": sample[0], "raw": data.hex()}), t_ns)

    def _on_key(self, data: bytes, t_ns: int) -> None:
        if sample := decoder.key(data):
            self._request_stop(self._trips.key(*sample))
            self._events.put(msgpack.packb({"kind": "key", "key": sample[0], "event": sample[1]}), t_ns)


def run(context: Context) -> int:
    """Run for ever: telemetry dies with the supervisor."""
    telemetry = Telemetry(context)
    rights.settle()
    context.heartbeat.state(heartbeat.RUNNING)
    telemetry.supervisor_bell.ring()
    ready: dict[int, int] = {}
    while True:
        telemetry.turn(ready)
        ready = telemetry.loop.wait(monotonic_ns() + TICK_NS)

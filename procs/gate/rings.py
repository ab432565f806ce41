"""Rings that the gate writes: the frames for the port owner, and the gate's part of the black box."""

from __future__ import annotations

from failstop.messages import box, records
from failstop.procs.context import Context
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.sources import Command
from failstop.shm.cell import RingWriter

NONE_YET = Command(records.NOBODY, "", -(2**62), (0.0, 0.0, 0.0), source="")


class Frames:
    """The ring of frames for the port owner. Each frame that is put wakes the port owner."""

    def __init__(self, context: Context) -> None:
        self._ring = context.own.ring_writer("frames")
        self._port_owner_bell = context.bell("port_owner_bell")
        self.epoch = 0
        """The newest epoch. Every frame carries it, except motion frames."""

    def put(self, kind: int, body: bytes, now_ns: int, epoch: int | None = None) -> None:
        """Put a frame into the ring. `epoch`: for a motion frame, the epoch in which motion was enabled. Other frames
        carry the newest epoch."""
        self._ring.put(records.FRAME.pack(self.epoch if epoch is None else epoch, kind, body), now_ns)
        self._port_owner_bell.ring()

    def stop(self, now_ns: int) -> None:
        self.put(records.WRITE_BURST, b"", now_ns)

    def drop_arm(self, now_ns: int) -> None:
        """Drop the frames for the arm that the port owner has not written yet. No stop is written."""
        self.put(records.DROP_ARM, b"", now_ns)


class GateBox:
    """The gate's part of the black box: one record per tick, with the newest command and the resulting speeds.

    If several sources send, the newest command is often not the one that drives. So that the driving commands have
    records too, at every second tick at least, such a record comes first, and the newest command waits for the next
    tick.
    """

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring
        self._newest = self._driver = NONE_YET
        """The newest command, and the newest driving command that has a record."""
        self._count = 0
        self._left = False
        """True if the newest command had to wait at the last tick."""

    def command(self, command: Command) -> None:
        """Record that a command came, whether it was accepted or not."""
        self._newest = command
        self._count += 1

    def tick(self, now_ns: int, core: GateCore, epoch: int) -> None:
        command, left, driver = self._newest, 0, core.sources.driving(now_ns)
        # A command that was ignored, or that stopped the robot, is never left for later: it is not fresh in any source.
        if (
            driver
            and not self._left
            and driver not in (command, self._driver)
            and core.sources.fresh(command.source, now_ns) is command
        ):
            command, left = driver, min(self._count, 1)
        drives = driver is command
        self._driver = command if drives else self._driver
        flags = core.enabled * box.ENABLED | command.manual * box.MANUAL | drives * box.DRIVES
        age_us = min(max(0, now_ns - command.t_ns) // 1000, box.MOST_U32)
        source, who = command.source.encode(), command.who.encode("utf-8", "replace")[: box.SHORT_WHO_BYTES]
        block = box.DECISION.get(core.blocked(now_ns), 1)
        speeds = len(core.speeds)
        room = (0.0,) * (box.MOST_SPEEDS - speeds)
        numbers = (*map(box.single, command.velocity), *core.velocity, *core.speeds, *room)
        count, self._count, self._left = min(self._count - left, 255), left, bool(left)
        head = (epoch & box.MOST_U32, block, flags, count, speeds, age_us)
        self._ring.put(box.TICK.pack(*head, *numbers, source, who), now_ns)

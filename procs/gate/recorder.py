"""The gate's part of the black box: the newest command and what became of it, at every tick; what the arm is to do."""

from __future__ import annotations

from failstop.shm import box

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.gate.arm.core import ArmCore
    from failstop.procs.gate.core import GateCore
    from failstop.procs.gate.sources import Command
    from failstop.shm.cell import RingWriter


ARM_EVERY_NS = 100_000_000


class ArmBox:
    """The gate's, of what the arm is to do: at each change of mode and mover, and ten times a second meanwhile."""

    __slots__ = ("_last", "_put_ns", "_ring")

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring
        self._last = ("", "")
        self._put_ns = 0

    def follow(self, now_ns: int, core: ArmCore) -> None:
        """Once a turn."""
        what = core.mode(), core.mover()
        if what != self._last or (what[0] and now_ns - self._put_ns >= ARM_EVERY_NS):
            self._last, self._put_ns = what, now_ns
            self._ring.put(box.pack_arm(*what, core.aims()), now_ns)


class GateBox:
    """The gate's: one record a tick, of the newest command and of what became of it."""

    __slots__ = ("_count", "_newest", "_ring")

    def __init__(self, ring: RingWriter) -> None:
        self._ring = ring
        self._newest: Command | None = None
        self._count = 0

    def command(self, command: Command) -> None:
        """A command came, good or bad."""
        self._newest = command
        self._count += 1

    def tick(self, now_ns: int, core: GateCore, epoch: int) -> None:
        """The end of a tick."""
        command = self._newest
        flags = box.ENABLED if core.enabled else 0
        age_us, source, who = box.LONGEST, b"", b""
        velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
        if command is not None:
            age_us = min(max(0, now_ns - command.t_ns) // 1000, box.LONGEST)
            velocity = tuple(map(box.single, command.velocity))
            source, who = command.source.encode(), command.who.encode("utf-8", "replace")[: box.WHO_BYTES]
            flags |= (box.MANUAL if command.manual else 0) | (
                box.DRIVES if core.sources.driving(now_ns) is command else 0
            )
        block = box.BLOCK.get(core.blocked(now_ns), 1)
        numbers = (*velocity, *core.velocity, *core.speeds)
        count, self._count = min(self._count, 255), 0
        self._ring.put(box.GATE.pack(epoch & box.LONGEST, block, flags, count, age_us, *numbers, source, who), now_ns)

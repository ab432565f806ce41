"""The faults of a simulated machine: what may happen to a process at a call of the system, and to others beside it."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from typing import Any

from failstop.lab.machine.files import Open, Port, Regular
from failstop.lab.machine.kernel import Process, Thread
from failstop.lab.machine.robot import MS
from failstop.lab.simulate.stage import Stage
from failstop.lab.simulate.witness import SERVICE, WRITERS

Fault = tuple[str, Callable[[], None]]
HELD_NS = 300 * MS
ASLEEP_S = 20.0
SHORT_OF: dict[str, int] = {
    "write": errno.EAGAIN,
    "open": errno.EMFILE,
    "spawn": errno.EAGAIN,
    "eventfd": errno.EMFILE,
    "pidfd_open": errno.EMFILE,
    "dup": errno.EMFILE,
    "fallocate": errno.ENOSPC,
    "sendmsg": errno.EAGAIN,
}
"""What a call is refused with by a machine that is short of something."""
PORT_REFUSES = (errno.EAGAIN, errno.EIO)
DISK_REFUSES = (errno.ENOSPC, errno.EIO)


def faults(stage: Stage, thread: Thread, call: str, about: tuple[Any, ...]) -> Iterator[Fault]:
    """The faults that may happen at this call, with their names."""
    process = thread.process
    yield "dies", lambda: stage.machine.die(process, -9)
    yield "held", lambda: _held(stage, process)
    if process.name not in SERVICE:
        return
    yield "starved", lambda: _held(stage, process, starved=True)
    yield "machine sleeps", lambda: stage.sleep_machine(ASLEEP_S)
    opened = process.files.get(about[0]) if call in ("write", "read") else None
    for number in _refusals(call, opened):
        yield errno.errorcode[number], _refused(stage, process, call, number)
    if call == "write" and opened and isinstance(opened.node, Port):
        yield "short write", lambda: _shortened(stage, process)
        yield "dies in mid-write", lambda: _cut(stage, process, opened, about[1])
    if process.name in WRITERS:
        for name in SERVICE:
            other = stage.robot.named(name)
            if other and other is not process:
                yield f"{name} dies beside", lambda other=other: _beside(stage, other)  # type: ignore[misc]


def _refusals(call: str, opened: Open | None) -> tuple[int, ...]:
    if opened and isinstance(opened.node, Port):
        return PORT_REFUSES
    if opened and isinstance(opened.node, Regular):
        return DISK_REFUSES
    return (SHORT_OF[call],) if call in SHORT_OF else ()


def _held(stage: Stage, process: Process, *, starved: bool = False) -> None:
    """For so long it runs nothing; `starved`: for want of a processor, which the service can tell."""
    stage.witness.held(process, HELD_NS)
    stage.machine.hold(process, HELD_NS, starved=starved)


def _refused(stage: Stage, process: Process, call: str, number: int) -> Callable[[], None]:
    def refuse() -> None:
        stage.witness.tell(f"{call} of {process.name} is refused: {os.strerror(number)}")
        raise OSError(number, os.strerror(number))

    return refuse


def _shortened(stage: Stage, process: Process) -> None:
    stage.witness.tell(f"a write of {process.name} is taken by half")
    stage.machine.shortened = True


def _cut(stage: Stage, process: Process, opened: Open, data: bytes) -> None:
    stage.witness.tell(f"half of a write of {process.name} is on the wire")
    opened.node.write(opened, data[: len(data) // 2])
    stage.machine.die(process, -9)


def _beside(stage: Stage, other: Process) -> None:
    """On another core, while this call is still to come: who waits for that death runs before it."""
    stage.machine.die(other, -9)
    stage.machine.give_way()

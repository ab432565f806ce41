"""The faults of a simulated machine: what may happen to a process at a call of the system, and to others beside it."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from failstop.messages import layout
from failstop_lab.machine.files import Fifo, Open, Regular
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Process, Thread
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.stage import Stage
from failstop_lab.simulate.witness import COMPARED, PORT_WRITERS, SERVICE_PROCESSES, TRUE_REPORTS

Fault = tuple[str, Callable[[], None]]
LONG_HOLD_NS = 300 * MS
BESIDE = " dies beside"
"""In the name of each fault that happens to another process than the one that makes the call."""
REPORTS_STOP, REPORTS_LATE = "reports stop", "reports are late"
LIES = {
    "reports say that the wheels stand": (0.0, 0.0),
    "reports say that the wheels turn": (1.0, 1.0),
    "reports say that the wheels turn the other way": (-1.0, 0.0),
}
"""So many times as fast as they turn, and so many turns a second more."""
REPORT_FAULTS = (REPORTS_STOP, REPORTS_LATE, *LIES)
BLIND_NS = 1_200 * MS
"""So long reports are not what they should be: longer than any answer to that takes."""
REPORTS_LATE_NS = 250 * MS
"""So late they are."""
LINES = 2
"""By so many lines of the call stack two calls are told apart."""
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
"""Errors of a machine that is short of something."""
PORT_REFUSES = (errno.EAGAIN, errno.EIO)
DISK_REFUSES = (errno.ENOSPC, errno.EIO)
INTERNAL = frozenset(
    {"dup", "epoll_create", "epoll_ctl", "eventfd", "mmap", "munmap", "sched_setscheduler"}
    | {"set_inheritable", "socketpair", "urandom"}
)
"""Calls that change nothing but what their own process has: nobody sees before its next call whether one was made."""


def line_of(call: str, about: tuple[Any, ...]) -> str:
    """The line of the service's code that makes the call, and the one that called it; of a write how much."""
    frame: FrameType | None = sys._getframe(1)
    while frame and "/lab/" in frame.f_code.co_filename:
        frame = frame.f_back
    lines: list[str] = []
    while frame and len(lines) < LINES:
        lines.append(f"{'/'.join(frame.f_code.co_filename.split('/')[-2:])}:{frame.f_lineno}")
        frame = frame.f_back
    return " < ".join(lines) + (f" ({len(about[1])} bytes)" if call == "write" else "")


def faults(
    stage: Stage, thread: Thread, call: str, about: tuple[Any, ...], held_ns: int = LONG_HOLD_NS
) -> Iterator[Fault]:
    """The faults that may happen at this call, with their names."""
    process = thread.process
    told = "" if held_ns == LONG_HOLD_NS else f" for {held_ns // MS} ms"
    yield "dies", lambda: stage.machine.die(process, -9)
    yield f"held{told}", lambda: _held(stage, process, held_ns)
    if process.name not in SERVICE_PROCESSES:
        return
    yield f"starved{told}", lambda: _held(stage, process, held_ns, starved=True)
    yield "machine sleeps", lambda: stage.sleep_machine(ASLEEP_S)
    opened = process.files.get(about[0]) if call in ("write", "read") else None
    if call == "read" and process.name == layout.TELEMETRY and opened and isinstance(opened.node, Port):
        for_ns = BLIND_NS if held_ns == LONG_HOLD_NS else held_ns
        for name in REPORT_FAULTS:
            yield name, lambda name=name: _blinded(stage, name, for_ns)  # type: ignore[misc]
    for number in _refusals(call, opened):
        yield errno.errorcode[number], _refused(stage, process, call, number)
    if call == "write" and opened and isinstance(opened.node, Port):
        yield "short write", lambda: _shortened(stage, process)
        yield "short write, while somebody asks for a stop", lambda: _shortened(stage, process, asked=True)
        yield "dies in mid-write", lambda: _cut(stage, process, opened, about[1])
        yield f"held{told} in the write", lambda: _held_in_write(stage, process, opened, about[1], held_ns)
    if process.name in PORT_WRITERS:
        yield "somebody asks for a stop", lambda: ask_beside(stage)
        for name in SERVICE_PROCESSES:
            other = stage.robot.named(name)
            if other and other is not process:
                yield f"{name}{BESIDE}", lambda other=other: _beside(stage, other)  # type: ignore[misc]
                if process.name == "port_owner":
                    told = f"{name}{BESIDE}, and a thread hears"
                    yield told, lambda other=other: _beside(stage, other, process)  # type: ignore[misc]


def _refusals(call: str, opened: Open | None) -> tuple[int, ...]:
    if opened and isinstance(opened.node, Port):
        return PORT_REFUSES
    if opened and isinstance(opened.node, Regular):
        return DISK_REFUSES
    return (SHORT_OF[call],) if call in SHORT_OF else ()


def stop_pipe(stage: Stage) -> Fifo | None:
    """The stop pipe, where there is one that is read."""
    here = stage.machine.root.names["run"]
    for part in ("failstop", "failstop", "stop"):
        here = getattr(here, "names", {}).get(part)  # type: ignore[assignment]
    return here if isinstance(here, Fifo) and here.ends(0, 2) else None


def ask_beside(stage: Stage) -> None:
    """Another program's bytes are in the stop pipe, where there is one that is read."""
    if pipe := stop_pipe(stage):
        stage.witness.asked()
        pipe.data += b"beside\n"
        pipe.notify()


def _held(stage: Stage, process: Process, ns: int, *, starved: bool = False) -> None:
    """For so long it runs nothing; `starved`: for want of a processor, which the service can tell."""
    stage.witness.held(process, ns)
    stage.machine.hold(process, ns, starved=starved)


def _held_in_write(stage: Stage, process: Process, opened: Open, data: bytes, ns: int) -> None:
    """Held while the kernel has its bytes in hand: who kills it meanwhile finds them on the wire a little later."""
    process.in_write = lambda: _land(stage, process, opened, data)
    _held(stage, process, ns)
    process.in_write = None


def _land(stage: Stage, process: Process, opened: Open, data: bytes) -> None:
    stage.witness.note(f"the write that {process.name} was in is done")
    with contextlib.suppress(OSError):
        opened.node.write(opened, data)


def _blinded(stage: Stage, name: str, ns: int) -> None:
    """For so long what the board reports stops, comes late, or is not true. The judge looks at its wheels."""
    board, machine = stage.robot.board, stage.machine
    if name in LIES:
        stage.witness.blind(ns, (TRUE_REPORTS, COMPARED))
    else:
        stage.witness.blind(ns + (REPORTS_LATE_NS if name == REPORTS_LATE else 0))

    def over() -> None:
        if name in LIES:
            board.lie(1.0)
        elif name == REPORTS_LATE:
            board.up_ns = 0
        else:
            board.model.silent = stage.silenced

    if name in LIES:
        board.lie(*LIES[name])
    elif name == REPORTS_LATE:
        board.up_ns = REPORTS_LATE_NS
    else:
        board.model.silent = True
    machine.at(machine.now_ns + ns, over)


def _refused(stage: Stage, process: Process, call: str, number: int) -> Callable[[], None]:
    def refuse() -> None:
        stage.witness.note(f"{call} of {process.name} is refused: {os.strerror(number)}")
        raise OSError(number, os.strerror(number))

    return refuse


def _shortened(stage: Stage, process: Process, *, asked: bool = False) -> None:
    stage.witness.cut(f"a write of {process.name} is taken by half")
    stage.machine.shortened = True
    if asked:
        ask_beside(stage)


def _cut(stage: Stage, process: Process, opened: Open, data: bytes) -> None:
    stage.witness.cut(f"half of a write of {process.name} is on the wire")
    opened.node.write(opened, data[: len(data) // 2])
    stage.machine.die(process, -9)


def _beside(stage: Stage, other: Process, hears: Process | None = None) -> None:
    """On another core, while this call is still to come: who waits for that death runs before it, or only the threads
    of one process."""
    stage.machine.die(other, -9)
    stage.machine.give_way(hears)

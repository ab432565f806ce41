"""Controls: one part of the stop protocol taken out, as in the failing rows of docs/dev/model.md, and the scenario that
must notice. A campaign that finds none of them finds nothing. A patch names a piece of source that is there once, so a
change of that code makes the control fail, not pass."""

from __future__ import annotations

from dataclasses import dataclass

from failstop.lab.machine.loading import Patches

ADMISSION = "failstop.procs.port_owner.admission"
PORT_OWNER = "failstop.procs.port_owner.main"
WIRE = "failstop.procs.port_owner.wire"
STOPPER = "failstop.procs.stopper.main"
SUPERVISOR = "failstop.supervisor.main"
STOP_PORT = "failstop.board.stop_port"


@dataclass(frozen=True)
class Control:
    """`row`: of docs/dev/model.md, or what is not in the model; `scenario`: what finds it."""

    row: str
    scenario: str
    patches: Patches


CONTROLS = (
    Control(
        "no epoch in frames",
        "drive_and_stop",
        ((ADMISSION, "frame_epoch == epoch and epoch > self.stopped_in", "epoch > self.stopped_in"),),
    ),
    Control(
        "own stop does not refuse motion",
        "supervisor_dies",
        ((ADMISSION, "frame_epoch == epoch and epoch > self.stopped_in", "frame_epoch == epoch"),),
    ),
    Control(
        "motion behind an early stop",
        "gate_dies",
        (
            (
                WIRE,
                "if self.lost or self.unsent or self._early or (self._holds()",
                "if self.lost or self.unsent or (self._holds()",
            ),
        ),
    ),
    Control(
        "one stop frame for a burst",
        "drive_and_stop",
        (
            (STOP_PORT, "self._stop = BOARD.burst_with(servos)", "self._stop = BOARD.stop"),
            (STOP_PORT, "return self._write(BOARD.first_stop)", "return self._write(BOARD.stop)"),
        ),
    ),
    Control(
        "the stopper does not fence",
        "port_owner_hangs",
        ((STOPPER, "HANG_NS = 250_000_000", "HANG_NS = 250_000_000_000"),),
    ),
    Control(
        "nobody answers the port owner's death",
        "port_owner_dies",
        ((SUPERVISOR, "written = self._port.burst()", "written = False"),),
    ),
    Control(
        "a new port hides the loss of the old",
        "replug",
        (
            (
                PORT_OWNER,
                "            if self.wire.fd >= 0:\n                self._port_lost(now_ns)\n            fd, self",
                "            fd, self",
            ),
        ),
    ),
    Control(
        "no lease of the gate",
        "gate_hangs",
        ((ADMISSION, "(layout.GATE, gate_ns), (layout.SUPERVISOR", "(layout.SUPERVISOR"),),
    ),
    Control(
        "a sleep of the machine goes unnoticed",
        "machine_sleeps",
        ((PORT_OWNER, "self.stop(now_ns, causes.SUSPENDED(slept_ns / 1e9))", "pass"),),
    ),
    Control(
        "a refused frame stays in the ring",
        "port_does_not_drain",
        ((WIRE, 'self.unsent = b"" if self.lost else data[taken:] if taken else b""', "self.unsent = data[taken:]"),),
    ),
)

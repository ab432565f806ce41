"""Controls of weak memory: one barrier of docs/dev/memory-order.md taken out, on the one side of its pair or the other,
and the scenario in which seeds must see that it is missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from failstop.lab.machine.loading import Patches
from failstop.lab.simulate.controls import PORT_OWNER_MODULE, SUPERVISOR_MODULE, Found, drawn
from failstop.lab.simulate.kinds import MEMORY

LATCH_MODULE, MONITOR_MODULE = "failstop.supervisor.latch", "failstop.supervisor.monitor"
GATE_MODULE, REQUESTS_MODULE = "failstop.procs.gate.main", "failstop.procs.gate.requests"
TELEMETRY_MODULE, CLIENT_MODULE, CELL_MODULE = (
    "failstop.procs.telemetry.main",
    "failstop.api.client",
    "failstop.shm.cell",
)
BARRIER = "self._barrier()\n"


def without(module: str, before: str, after: str, barrier: str = BARRIER) -> Patches:
    """The change that takes out the barrier between these two pieces of source."""
    indent = " " * (len(after) - len(after.lstrip()))
    return ((module, f"{before}{indent}{barrier}{after}", f"{before}{after}"),)


@dataclass(frozen=True)
class WeakControl:
    """`row`: the litmus test, and of which process the barrier is."""

    row: str
    scenario: str
    patches: Patches
    groups: tuple[str, ...] = MEMORY


PUT = without(CELL_MODULE, "", "        self._view[at : at + len(data)] = data\n")
WEAK_CONTROLS = (
    WeakControl(
        "cause, ready: supervisor",
        "drive_and_stop",
        without(LATCH_MODULE, "        self.ready_word.set(0)\n", "        self._epoch_word.set(self.number)\n"),
    ),
    WeakControl(
        "cause, ready: gate",
        "drive_and_stop",
        without(GATE_MODULE, "", "        if entry := self._latch.read():\n"),
    ),
    WeakControl(
        "moving: port owner",
        "stopper_dies_while_telemetry_hangs",
        without(
            PORT_OWNER_MODULE,
            "        self._moving_word.set(1)\n",
            "        now_ns = monotonic_ns()\n        frame = motion[0]\n",
        ),
    ),
    WeakControl(
        "moving: supervisor",
        "stopper_dies_while_telemetry_hangs",
        without(SUPERVISOR_MODULE, "", "        if self._moving_word.get():\n"),
    ),
    WeakControl("ring: any writer", "drive_and_stop", PUT),
    WeakControl(
        "ring: its readers", "drive_and_stop", without(CELL_MODULE, "", "        if self._check(", "Barrier()()\n")
    ),
    WeakControl(
        "still: telemetry",
        "drive_and_stop",
        without(
            TELEMETRY_MODULE,
            "        self._still_word.set(judge.still_ns)\n",
            "        self._judged_word.set(judge.judged_ns)\n",
        ),
    ),
    WeakControl(
        "still: supervisor", "drive_and_stop", without(MONITOR_MODULE, "", "        still_ns = self._still.get()\n")
    ),
    WeakControl(
        "unknown: telemetry",
        "drive_and_stop",
        (
            (
                TELEMETRY_MODULE,
                "            self._judged_word.set(0)\n            self._barrier()\n",
                "            self._judged_word.set(0)\n",
            ),
        ),
    ),
    WeakControl(
        "unknown: supervisor",
        "drive_and_stop",
        without(
            MONITOR_MODULE, "        still_ns = self._still.get()\n", "        if self._judged.get() != judged_ns:\n"
        ),
    ),
    WeakControl(
        "reply: gate",
        "drive_and_stop",
        (*PUT, *without(REQUESTS_MODULE, "", "            for index, answer in self._answers:\n")),
    ),
    WeakControl(
        "reply: client",
        "drive_and_stop",
        without(CLIENT_MODULE, "", "                return reply if number == asked", "Barrier()()\n"),
    ),
    WeakControl(
        "reset, asked: gate",
        "drive_and_stop",
        without(REQUESTS_MODULE, "", "        self._asked_word.set(self._asked_word.get() + 1)\n"),
    ),
    WeakControl(
        "reset, asked: supervisor", "drive_and_stop", without(LATCH_MODULE, "", "        reply = self.latch.reset(")
    ),
    WeakControl(
        "reset, decided: supervisor",
        "drive_and_stop",
        without(LATCH_MODULE, "", "        self._decided_word.set(number)\n"),
    ),
    WeakControl(
        "reset, decided: gate", "drive_and_stop", without(REQUESTS_MODULE, "", "        entry = self._decided.read()\n")
    ),
)


def search_weak(seconds: float, wanted: Callable[[str], bool] = lambda row: True) -> Iterator[Found]:
    """Each of them, by seeds for so long. `wanted`: asked with its row."""
    for control in WEAK_CONTROLS:
        if wanted(control.row):
            yield drawn(control.row, seconds, control.patches, control.scenario, groups=control.groups)

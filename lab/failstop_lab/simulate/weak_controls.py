"""Controls of weak memory: one barrier of model/aarch64/README.md taken out, on the one side of its pair or the other,
and the scenario in which seeds must see that it is missing."""

from __future__ import annotations

import itertools

from failstop_lab.machine.loading import Patches
from failstop_lab.simulate.controls import PORT_OWNER_MODULE, STOPPER_MODULE, SUPERVISOR_MODULE, Mutant
from failstop_lab.simulate.events import MEMORY

LATCH_MODULE, TRACKER_MODULE = "failstop.supervisor.latch", "failstop.supervisor.stop_tracker"
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


def control(row: str, scenario: str, *patches: Patches) -> Mutant:
    """A control in which memory alone is odd."""
    return Mutant(row, scenario, tuple(itertools.chain.from_iterable(patches)), groups=MEMORY)


PUT = without(CELL_MODULE, "", "        self._view[at : at + len(data)] = data\n")
RESETS, ASKS, LASTS = "resets", "asks_and_looks", "stop_stays"
WEAK_CONTROLS = (
    control(
        "cause, ready: supervisor",
        RESETS,
        without(LATCH_MODULE, "        self.ready_word.set(0)\n", "        self._epoch_word.set(self.number)\n"),
    ),
    control(
        "cause, ready, reset decided: gate",
        RESETS,
        without(GATE_MODULE, "", "        if entry := self._latch.read():\n"),
    ),
    control(
        "moving: port owner",
        "two_fall_silent",
        without(
            PORT_OWNER_MODULE,
            "        self._moving_word.set(1)\n",
            "        now_ns = monotonic_ns()\n        frame = motion[0]\n",
        ),
    ),
    control(
        "moving: supervisor",
        "two_fall_silent",
        without(SUPERVISOR_MODULE, "", "        if self._moving_word.get():\n"),
        (
            (
                SUPERVISOR_MODULE,
                "                self.blackbox.latched(latch.stop, self.epochs.number)\n",
                "                pass\n",
            ),
        ),
    ),
    control(
        "look: supervisor", "starves_again", without(SUPERVISOR_MODULE, "", "        if self._moving_word.get():\n")
    ),
    control(
        "look: stopper",
        "starves_longer",
        without(STOPPER_MODULE, "", "        return is_starved and not self._port_owner_moving.get()\n"),
    ),
    control("ring: any writer", "crowd", PUT),
    control("ring: its readers", "crowd", without(CELL_MODULE, "", "        if self._check(", "Barrier()()\n")),
    control(
        "still: telemetry",
        LASTS,
        without(
            TELEMETRY_MODULE,
            "        self._still_word.set(judge.still_ns)\n",
            "        self._judged_word.set(judge.judged_ns)\n",
        ),
    ),
    control("still: supervisor", LASTS, without(TRACKER_MODULE, "", "        still_ns = self._still.get()\n")),
    control(
        "unknown: telemetry",
        LASTS,
        (
            (
                TELEMETRY_MODULE,
                "            self._judged_word.set(0)\n            self._barrier()\n",
                "            self._judged_word.set(0)\n",
            ),
        ),
    ),
    control(
        "unknown: supervisor",
        LASTS,
        without(
            TRACKER_MODULE, "        still_ns = self._still.get()\n", "        if self._judged.get() != judged_ns:\n"
        ),
    ),
    control("reply: gate", ASKS, PUT),
    control(
        "reply: client",
        ASKS,
        without(CLIENT_MODULE, "", "                return reply if number == asked", "Barrier()()\n"),
    ),
    control(
        "reset asked: gate",
        RESETS,
        without(REQUESTS_MODULE, "", "        self._asked_word.set(self._asked_word.get() + 1)\n"),
    ),
    control("reset asked: supervisor", RESETS, without(LATCH_MODULE, "", "        reply = self.latch.reset(")),
    control("reset decided: supervisor", RESETS, without(LATCH_MODULE, "", "        self._decided_word.set(number)\n")),
)

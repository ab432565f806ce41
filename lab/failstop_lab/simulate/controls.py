"""Controls: one part of the stop protocol taken out, as in the failing rows of model/README.md, and the scenario that
must notice, by seeds or else by its single faults. A campaign that finds none of them finds nothing. A patch names a
piece of source that is there once, so a change of that code makes the control fail, not pass."""

from __future__ import annotations

from dataclasses import dataclass

from failstop.policy.layouts import BOARDS
from failstop_lab.machine.loading import Patches
from failstop_lab.simulate.equivalents import ASKS, IS_HELD

ADMISSION_MODULE = "failstop.procs.port_owner.admission"
PORT_OWNER_MODULE = "failstop.procs.port_owner.main"
WIRE_MODULE = "failstop.procs.port_owner.port_writer"
STOPPER_MODULE = "failstop.procs.stopper.main"
SUPERVISOR_MODULE = "failstop.supervisor.main"
STATUS_MODULE = "failstop.supervisor.status"
HANDOVER_MODULE = "failstop.supervisor.port_handover"
TABLE_MODULE = "failstop.supervisor.process_table"
GUARD_MODULE = "failstop.guard.guard"
CORE_MODULE = "failstop.procs.gate.core"
CONDITIONS_MODULE = "failstop.procs.gate.conditions"
CELL_MODULE = "failstop.shm.cell"
PORT_MODULE = "failstop.procs.port_owner.port"
PEER_MODULE = "failstop.procs.peer"
STOP_PORT_MODULE = "failstop.board.stop_port"
TELEMETRY_MODULE = "failstop.procs.telemetry.main"
UNASKED_MODULE = "failstop.procs.telemetry.unasked"
TURNING_MODULE = "failstop.procs.gate.turning"
SOURCES_MODULE = "failstop.procs.gate.sources"
TRACKER_MODULE = "failstop.supervisor.stop_tracker"

CUT_AND_ASKED = "short write, while somebody asks for a stop"
NOT_REPEATED = ("failstop.board.described", "tuple(row[1:] for row in wire.stop.repeats_ns)", "((), (), ())")

OWN_SILENCE = (PORT_OWNER_MODULE, ">= HANG_NS:", ">= 1000 * HANG_NS:")

NOT_EXPRESSED = {
    "the stop tool kills nobody": "the stop tool of systemd is no part of the simulated machine",
    "a new port hides the loss of the old": "each turn asks the old port what it holds before it takes a new one",
    "a refused frame stays in the ring": "a stop drops it, and without one it is late by less than DRAIN_NS",
    "bell": "the kernel's own locks",
}
"""Failing rows of model/README.md and controls of model/aarch64/README.md that no change of the source stands for.
weak_controls.py has those that are expressed where a store may be late."""


@dataclass(frozen=True)
class Mutant:
    """`row`: of model/README.md, the pair of model/aarch64/README.md and whose barrier it is, or what is in neither;
    `scenario`: what finds it; `fault`: the one that does, where trying every other first takes minutes."""

    row: str
    scenario: str
    patches: Patches
    fault: str = ""
    board: str = BOARDS[0]
    """The kind of board at which it is tried."""
    groups: tuple[str, ...] = ()
    """The kinds of events that seeds of it may draw; empty: all."""
    claims: tuple[str, ...] = ()
    """The claims (lab/case/claims.py) that rest on what is taken out."""
    bug: str = ""
    """What the changed code does wrong, for docs/safety.md, if `row` is a name that only the model's readers know."""


CONTROLS = (
    Mutant(
        "no epoch in frames",
        "stops_in_one_breath",
        ((ADMISSION_MODULE, "frame_epoch == epoch and epoch > self.stopped_in", "epoch > self.stopped_in"),),
        claims=("MOVE-1", "MOVE-2"),
        bug="the port owner does not check the epoch of motion frames",
    ),
    Mutant(
        "own stop does not refuse motion",
        "supervisor_dies",
        ((ADMISSION_MODULE, "frame_epoch == epoch and epoch > self.stopped_in", "frame_epoch == epoch"),),
        claims=("MOVE-1",),
    ),
    Mutant(
        "motion behind an early stop",
        "gate_dies",
        (
            (
                WIRE_MODULE,
                "if self.lost or self.unsent or self._early or (self.holds()",
                "if self.lost or self.unsent or (self.holds()",
            ),
        ),
        claims=("MOVE-1",),
    ),
    Mutant(
        "one stop frame for a burst",
        "drive_and_stop",
        (
            (STOP_PORT_MODULE, "self._stop = board.burst + ", "self._stop = board.stop + "),
            (STOP_PORT_MODULE, "taken = self._write(self.board.first_stop)", "taken = self._write(self.board.stop)"),
        ),
        CUT_AND_ASKED,
        claims=("BOARD-2",),
        bug="a stop is a single stop frame instead of a burst",
    ),
    Mutant(
        "the port owner does not notice that the gate is silent",
        "gate_hangs",
        (
            (
                ADMISSION_MODULE,
                "in ((layout.GATE, gate_ns), (layout.SUPERVISOR, supervisor_ns)):",
                "in ((layout.SUPERVISOR, supervisor_ns),):",
            ),
        ),
        claims=("HANG-1",),
    ),
    Mutant(
        "nobody fences",
        "port_owner_hangs",
        (
            (SUPERVISOR_MODULE, "os.kill(child.pid, signal.SIGKILL)", "pass"),
            (STOPPER_MODULE, "            life.kill()\n", ""),
        ),
        claims=("RETURN-1",),
        bug="a process that hangs is not killed",
    ),
    Mutant(
        "the stopper does not fence",
        "stopper_alone_runs",
        ((STOPPER_MODULE, "            life.kill()\n", ""), OWN_SILENCE),
        claims=("MOVE-1",),
    ),
    Mutant(
        "the port owner does not notice its own silence",
        "stopper_alone_runs",
        (OWN_SILENCE,),
        IS_HELD,
        claims=("HANG-1",),
    ),
    Mutant(
        "the stopper does not notice that the port owner is silent",
        "port_owner_and_supervisor_hang",
        ((STOPPER_MODULE, "self._excused_ns) + HANG_NS", "self._excused_ns) + 1000 * HANG_NS"),),
        claims=("SEVERAL-1",),
    ),
    Mutant(
        "fencing writes before it kills",
        "port_owner_hangs_shortly",
        (
            (
                SUPERVISOR_MODULE,
                "        os.kill(child.pid, signal.SIGKILL)\n        kill_ns = monotonic_ns()\n"
                "        stop.written_ns = self._burst() if name == layout.PORT_OWNER else 0\n",
                "        stop.written_ns = self._burst() if name == layout.PORT_OWNER else 0\n"
                "        os.kill(child.pid, signal.SIGKILL)\n        kill_ns = monotonic_ns()\n",
            ),
        ),
        claims=("MOVE-1",),
    ),
    Mutant(
        "ready before the port owner's answer",
        "port_owner_held_in_its_write",
        ((STATUS_MODULE, "carried_out = self._epochs.answered() and not stopping", "carried_out = not stopping"),),
        claims=("MOVE-1",),
    ),
    Mutant(
        "an early stop beside the loop's write",
        "gate_dies",
        (
            (
                STOP_PORT_MODULE,
                "        with self._writing:\n            if self.fd >= 0:\n                self._write_early()",
                "        if self.fd >= 0:\n            self._write_early()",
            ),
        ),
        claims=("MOVE-1",),
    ),
    Mutant(
        "the supervisor does not write a stop when the port owner dies",
        "port_owner_dies",
        (
            (
                SUPERVISOR_MODULE,
                "written, now_ns = self._port.burst(), monotonic_ns()",
                "written, now_ns = False, monotonic_ns()",
            ),
            (
                TABLE_MODULE,
                "stop = self._port.early_stop if child.row.name == layout.PORT_OWNER else None",
                "stop = None",
            ),
        ),
        claims=("DEATH-1",),
    ),
    Mutant(
        "stays down, and no second burst",
        "port_owner_hangs_and_stays_down",
        (
            (SUPERVISOR_MODULE, "written_ns = self._burst() if port_owner in dead else 0", "written_ns = 0"),
            (
                TABLE_MODULE,
                "stop = self._port.early_stop if child.row.name == layout.PORT_OWNER else None",
                "stop = None",
            ),
            (STOPPER_MODULE, "        if not self._succeeded():\n            self._burst(now_ns)\n", ""),
            (PEER_MODULE, "        if self.named() == pid:\n            self._stop()\n", ""),
        ),
        "held in the write",
        claims=("DEATH-1",),
    ),
    Mutant(
        "stays down, and no burst at the return",
        "port_owner_stays_down",
        (
            (HANDOVER_MODULE, "written = StopPort(fd, self._board).burst()", "written = True"),
            (STOPPER_MODULE, "        if not self._succeeded():\n            self._burst(now_ns)\n", ""),
            (STOPPER_MODULE, "            self._write()\n\n    def _hangs_ns", "\n    def _hangs_ns"),
        ),
        claims=("PORT-1",),
        bug="no process writes a stop to a board that is back while the port owner is down",
    ),
    Mutant(
        "a sleep of the machine goes unnoticed",
        "machine_sleeps",
        ((PORT_OWNER_MODULE, "self.stop(now_ns, causes.SUSPENDED(slept_ns / 1e9))", "pass"),),
        claims=("TIME-1",),
    ),
    Mutant(
        "a wheel that runs away does not stop the robot",
        "wheel_runs_away",
        ((TELEMETRY_MODULE, "self._raise(causes.RUNAWAY(name, told, seen))", "pass"),),
        board="hoverboard",
        claims=("RUNAWAY-1",),
    ),
    Mutant(
        "a board that falls silent does not stop the robot",
        "board_says_nothing",
        ((TRACKER_MODULE, "{LINK_DEAF: causes.DEAF, LINK_SILENT: causes.BOARD_SILENT}", "{LINK_DEAF: causes.DEAF}"),),
        board="ugv",
        claims=("SILENCE-1",),
    ),
    Mutant(
        "wheels that turn although zero is commanded do not disable motion",
        "wheels_turn_unasked",
        ((TURNING_MODULE, "if not unexpected or by != _BY_REPORTS:", "if unexpected or by != _BY_REPORTS:"),),
        board="hoverboard",
        claims=("RUNAWAY-1",),
    ),
    Mutant(
        "wheels that keep turning although motion was disabled latch no stop",
        "wheels_turn_unasked",
        ((UNASKED_MODULE, "return Reaction(causes.UNSTILL(), False, None)", "return NO_REACTION"),),
        board="hoverboard",
        claims=("RUNAWAY-1",),
    ),
    Mutant(
        "a program drives on through an enable",
        "commands_through_an_enable",
        ((SOURCES_MODULE, "for source in self._rank if source not in self._held)", "for source in self._rank)"),),
    ),
    Mutant(
        "the board's own watchdog is not armed",
        "drive_and_stop",
        ((PORT_MODULE, "self._opening = board.port.opening", "self._opening = ()"),),
        board="ugv",
        claims=("WATCHDOG-1",),
    ),
    Mutant(
        "no CR before the stop",
        "drive",
        (("failstop.board.arduino.codec", r'STOP = b"\rm 0 0\r"', r'STOP = b"m 0 0\r"'), NOT_REPEATED),
        CUT_AND_ASKED,
        "arduino",
        claims=("BOARD-2",),
    ),
    Mutant(
        "no line feed before the stop",
        "drive",
        (("failstop.board.ugv.codec", r"""STOP = b'\n{"T":1,""", """STOP = b'{"T":1,"""), NOT_REPEATED),
        CUT_AND_ASKED,
        "ugv",
        claims=("BOARD-2",),
    ),
    Mutant(
        "the second motor's stop is left out",
        "drive",
        (
            (
                "failstop.board.vesc.codec",
                "self.burst = self.rest + bytes(BURST - 2 * len(self.rest)) + self.rest",
                "self.burst = packet(_SPEED.pack(DUTY, 0)) + bytes(BURST)",
            ),
        ),
        ASKS,
        "vesc",
        claims=("BOARD-2",),
    ),
    Mutant(
        "the second CAN motor's stop is left out",
        "drive",
        (
            (
                "failstop.board.damiao.codec",
                "self.burst = slcan.FLUSH + slcan.OPEN + _lines((0.0,) * MOST)",
                "self.burst = slcan.FLUSH + slcan.OPEN + slcan.line(SPEED_ID + 1, bytes(8))",
            ),
        ),
        ASKS,
        "damiao",
        claims=("BOARD-2",),
    ),
    Mutant("a stop is not repeated", "drive", (NOT_REPEATED,), CUT_AND_ASKED, "hoverboard", claims=("BOARD-2",)),
    Mutant(
        "a command stays valid for a thousand times its timeout",
        "silence",
        ((SOURCES_MODULE, "{name: timeout_ns for", "{name: 1000 * timeout_ns for"),),
        claims=("CLIENT-1",),
    ),
    Mutant(
        "the zero behind motion is not repeated",
        "silence",
        ((PORT_OWNER_MODULE, "if stands and turned:", "if False:"),),
        board="hoverboard",
        claims=("CLIENT-1",),
    ),
    Mutant(
        "a run begins without a stop",
        "drive_and_stop",
        (
            (HANDOVER_MODULE, "own.stopped = own.burst()", "own.stopped = True"),
            (SUPERVISOR_MODULE, "elif self._repeats.pop(now_ns) and self._port.burst():", "elif False:"),
            (
                PORT_OWNER_MODULE,
                "        self._burst()\n        self._stopped_word.set(self.epoch)\n        self.wire",
                "        self._stopped_word.set(self.epoch)\n        self.wire",
            ),
        ),
        claims=("START-1",),
    ),
    Mutant(
        "a board that is back is not stopped first",
        "replug",
        (
            (HANDOVER_MODULE, "written = StopPort(fd, self._board).burst()", "written = True"),
            (WIRE_MODULE, "        self._refused = False\n        self.burst()\n", "        self._refused = False\n"),
        ),
        claims=("PORT-1",),
    ),
    Mutant(
        "bytes in the stop pipe do not stop the robot",
        "stop_pipe",
        (
            (
                PORT_OWNER_MODULE,
                "        self.wire.burst()\n        written_ns = monotonic_ns()\n        give_way()\n"
                "        self._own_stop(now_ns, written_ns, self._requests.accept(now_ns))\n",
                "        self._requests.accept(now_ns)\n",
            ),
        ),
        claims=("ASK-1",),
    ),
    Mutant(
        "the board's stop key does not stop the robot",
        "key",
        (
            (
                PORT_OWNER_MODULE,
                "            self.wire.burst()\n"
                "            self._own_stop(entry[1], monotonic_ns(), causes.read(entry[2]))\n",
                "            pass\n",
            ),
        ),
        claims=("ASK-1",),
    ),
    Mutant(
        "the service does not notice that its stop pipe was removed",
        "pipe_is_removed",
        ((SUPERVISOR_MODULE, "if cause := self._run.lost(now_ns):", "if cause := None:"),),
        claims=("ASK-2",),
    ),
    Mutant(
        "the command of a dead driver stays valid",
        "driver_dies",
        (
            (CORE_MODULE, "        self.sources.drop(session)\n", ""),
            (CORE_MODULE, "            return causes.DRIVER_DIED(driver.who)\n", "            return None\n"),
        ),
        claims=("CLIENT-1",),
    ),
    Mutant(
        "a command that is not a number is accepted",
        "two_programs",
        (
            (
                CORE_MODULE,
                "        if not all(map(isfinite, command.velocity)):\n"
                "            return causes.NOT_FINITE(command.who)\n",
                "",
            ),
        ),
        claims=("CLIENT-1",),
    ),
    Mutant(
        "two programs may command under one source",
        "two_programs",
        ((CORE_MODULE, "if rival is not None:", "if False:"),),
        claims=("CLIENT-1",),
    ),
    Mutant(
        "records with a wrong CRC are accepted",
        "memory_is_damaged",
        ((CELL_MODULE, " or crc32(raw[4:end], crc_seed) != crc", ""),),
        claims=("MEMORY-1",),
    ),
    Mutant(
        "a driver's death leaves motion enabled",
        "another_commands_after_a_death",
        (
            (
                CORE_MODULE,
                "        self.stand_still()\n        self.notes.append(disabled_by_death(driver, moved=moved))\n",
                "        self.notes.append(disabled_by_death(driver, moved=moved))\n",
            ),
        ),
        claims=("CLIENT-1", "MOVE-2"),
    ),
    Mutant(
        "a lost interlock does not disable motion",
        "interlock_is_lost",
        (
            (
                CORE_MODULE,
                'unmet = self.interlocks.unmet(now_ns) if self.enabled else ""',
                'unmet = ""',
            ),
        ),
        claims=("SENSOR-1",),
    ),
    Mutant(
        "a silent obstacle sensor does not block motion",
        "sensor_falls_silent",
        (
            (CORE_MODULE, "if not driving.manual and self.scan.silent(now_ns):", "if False:"),
            (CORE_MODULE, "if self.scan.on and not driving.manual:", "if False:"),
        ),
        claims=("SENSOR-1",),
    ),
    Mutant(
        "an operator who is no longer heard does not stop the robot",
        "operator_is_lost",
        (
            (
                CONDITIONS_MODULE,
                "return causes.OPERATOR_GONE(*self._last) if self.unmet(now_ns) else None",
                "return None",
            ),
            (
                CORE_MODULE,
                "        if self.attendance.on:\n            ends_ns",
                "        if False:\n            ends_ns",
            ),
        ),
        claims=("ATTEND-1",),
    ),
    Mutant(
        "zero is not repeated to a stopped board",
        "board_falls_silent",
        ((PORT_OWNER_MODULE, "            self.wire.frame(self.board.refresh)\n", "            pass\n"),),
        claims=("BOARD-1",),
    ),
    Mutant(
        "a disable leaves motion enabled",
        "commands_after_a_disable",
        (
            (
                CORE_MODULE,
                "        self.enabled = False\n        self.enabled_ns = 0\n        self.sources.clear()\n",
                "        self.sources.clear()\n",
            ),
        ),
        claims=("MOVE-2",),
    ),
    Mutant(
        "speeds above the limit are not reduced",
        "commands_more_than_the_limit",
        ((CORE_MODULE, "max(-limit, min(limit, want))", "want"),),
        claims=("LIMIT-1",),
    ),
    Mutant(
        "a driver's death at the guard port goes unnoticed",
        "guard_driver_dies",
        ((GUARD_MODULE, "        if news.ended:\n            self._end(emptied=news.emptied)\n", ""),),
        board="arduino",
        claims=("GUARD-1",),
    ),
    Mutant(
        "a process that has died is not started again",
        "gate_dies",
        ((TABLE_MODULE, "        child.restart.set(now_ns + wait_ns)\n", ""),),
        claims=("RETURN-1",),
    ),
)

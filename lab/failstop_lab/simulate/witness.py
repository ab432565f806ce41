"""Witness: judges a run by the frames that the simulated board executes. It knows which faults happened to the machine
and what programs asked for, and it never asks the service.

Each reason to stop has a bar (Deadline): once its time is over, no frame may turn the wheels before a program asks for
motion again. Nobody can stop wheels that no process reaches, so the bar begins again when one does. The bars are the
first board's; another board may take Traits.late_ns longer, because of its own line and loop.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from enum import Enum, auto

from failstop.board.kinds import is_described
from failstop.board.rrc.framing import MOTOR
from failstop_lab.boards.line import ADAPTER_BAR_NS, model_of
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import MS, Robot
from failstop_lab.sim.model import Frame

CLAIMS = {
    "a stop comes in its time": (
        *("DEATH-1", "HANG-1", "SEVERAL-1", "ASK-1", "ASK-2"),
        *("CLIENT-1", "SENSOR-1", "ATTEND-1", "PORT-1", "BOARD-1", "TIME-1", "END-1"),
    ),
    "wheels that no program commands any more stand still": ("CLIENT-1",),
    "no frame behind a stop but the one past its last look": ("MOVE-1",),
    "the first bytes of a run, and to a board that is back, are a stop": ("START-1", "PORT-1"),
    "no motion before a program asks for it": ("MOVE-2", "START-1", "END-1"),
    "never faster than a program asks for, or than the limit": ("LIMIT-1", "MEMORY-1"),
    "motion comes back within 2 s once nothing fails": ("RETURN-1",),
    "no frame writes outside of the motors": ("BOARD-2",),
    "the board's own watchdog stops what is frozen for good": ("WATCHDOG-1",),
    "no invariant of the core is broken": ("MOVE-1", "MOVE-2"),
    "shared memory is seen in the order of the litmus tests": ("MOVE-1", "MOVE-2", "CAUSE-1", "PROOF-1"),
    "no entry of a ring is passed over": ("ASK-1",),
}
"""The rules by which a run is judged, and the claims (lab/case/claims.py) that each rule supports."""
SERVICE_PROCESSES = ("supervisor", "port_owner", "gate", "telemetry", "stopper")
PORT_WRITERS = ("supervisor", "port_owner", "stopper")
DEATH_NS = 8 * MS
"""From a death to the stop at the board: a burst that is on the wire before it, its own bytes, and the steps of the
processes that write it."""
RESUMED_NS = 3 * MS
"""A port owner that was held up after its last look writes its one frame within this time of going on."""
REPEAT_NS = 20 * MS
"""From a stop to its first repeat."""
ASKED_NS = 4 * MS
BACK_NS = 30 * MS
HANG_BAR_NS = {
    "gate": 85 * MS,
    "supervisor": 85 * MS,
    "port_owner": 130 * MS,
    "stopper": 280 * MS,
    "telemetry": 530 * MS,
}
"""From the last beat to the stop at the board: the lease or the deadline, a tick, and the steps."""
ANY_REPORTS, TRUE_REPORTS, COMPARED = "reports", "true reports", "reports compared with commands"
"""Who notices what the board says at all, what shows only in what it truly says of its wheels, and what shows only when
that has been compared with commands for long enough."""
SEES_AGAIN_NS = 1_500 * MS
"""A telemetry that was held up compares reports with commands again once it knows both for long enough."""
COMMAND_COUNTS_NS = 300 * MS
"""A command counts for so long, as no scenario sets it otherwise (gate.command_timeout_s)."""
SILENCE_BAR_NS = 25 * MS
"""From the moment at which the last command counts no more to the stop at the board: a tick, and its own bytes."""
STOPPER_NS = 290 * MS
"""While supervisor and port owner are both silent, the stopper is the one that notices."""
ZEROS_NS = 250 * MS
"""While it is stopped a board is told zero again within so long."""
SLACK_RPS = 1e-3


class Phase(Enum):
    """What a deadline waits for."""

    UNREACHED = auto()
    """A process that reaches the wheels: until there is one, the bar begins again and again."""
    BAR = auto()
    """The bar of the first board."""
    OWN_TIME = auto()
    """The time that this board's own line and loop may add, because the wheels still turned at the end of the bar."""
    ZEROS = auto()
    """The zeros after a stop, because a pause has moved the repeats, whose times are chosen against the board's own
    loop, so the board may have lost them."""


class Deadline:
    """One reason to stop, and its time. It ends with a verdict, or when a program asks for motion."""

    def __init__(
        self, witness: Witness, why: str, within_ns: int, by: str, moot: Callable[[], bool], *, forbids: bool = True
    ) -> None:
        """`within_ns`: the bar; `by`: the process that notices, if it is not one of the PORT_WRITERS; `moot`: whether
        nobody could notice, so there is no verdict; `forbids`: no frame may turn the wheels afterwards."""
        self._forbids = forbids
        self._witness, self._machine, self._board = witness, witness.machine, witness.board
        self._why, self._within_ns, self._by, self._moot = why, within_ns, by, moot
        self._asked = witness.asked_for_motion
        self._phase = Phase.BAR
        self._begun_ns = self._paused_ns = self._own_ns = 0

    def begin(self, phase: Phase, *, after_ns: int = 0, left_ns: int | None = None) -> None:
        """Begin a phase after this time. `left_ns`: how much of it is left, if not all."""
        self._phase, self._begun_ns = phase, self._machine.now_ns
        self._paused_ns, self._own_ns = self._witness.all_paused_ns(self._by), self._witness.own_ns()
        if left_ns is None:
            left_ns = self._own_ns if phase is Phase.OWN_TIME else self._within_ns
        self._machine.at(self._begun_ns + max(0, after_ns) + left_ns, self._due)

    def _due(self) -> None:
        if self._witness.asked_for_motion != self._asked or self._moot():
            return
        now_ns, again_ns = self._machine.now_ns, self._begins_again_ns()
        if again_ns is not None:
            # A process that reaches the wheels only just before the end of a bar would have no time.
            reached = self._witness.reached()
            self.begin(Phase.BAR if reached else Phase.UNREACHED, after_ns=again_ns - now_ns)
        elif more_ns := self._witness.all_paused_ns(self._by) - self._paused_ns:
            self.begin(self._phase, left_ns=more_ns)
        else:
            self._board.catch_up()
            reached = self._witness.reached()
            if self._phase is Phase.UNREACHED or not reached:
                self.begin(Phase.BAR if reached else Phase.UNREACHED, after_ns=self._witness.wire_ns - now_ns)
            else:
                self._end_phase()

    def _begins_again_ns(self) -> int | None:
        """When the bar begins again, because the port has kept bytes or refused a stop since; None: it does not."""
        port = self._board.port
        if port and port.drained_ns > self._begun_ns:
            return self._witness.wire_ns  # the board reads only now what the port had kept
        if port and port.took_again_ns + REPEAT_NS > self._begun_ns:
            return port.took_again_ns + REPEAT_NS  # a refused stop is written again with the first repeat
        return None

    def _end_phase(self) -> None:
        """Call when the time of the phase is over and a process reaches the wheels."""
        may_be_late = self._own_ns > 0 and any(self._board.model.driven)
        if may_be_late and self._phase is Phase.BAR:
            self.begin(Phase.OWN_TIME)
        elif may_be_late and self._phase is Phase.OWN_TIME and self._repeats_were_moved():
            self.begin(Phase.ZEROS, left_ns=ZEROS_NS)
        else:
            self._witness.must_be_still(self._why, self._within_ns + self._own_ns, forbids=self._forbids)

    def _repeats_were_moved(self) -> bool:
        return self._witness.late_until_ns() + ADAPTER_BAR_NS > self._machine.now_ns


class Witness:
    """The judge of one run. `violations` lists each fault once; `story` says what happened, and when."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self.machine, self.board = robot, robot.machine, robot.board
        self._traits, language = robot.board.traits, robot.board.traits.language
        self._first_stop, self._byte_ns = language.first_stop, language.port.byte_ns
        self._fuses = is_described(self._traits.kind) and model_of(self._traits.kind).fuses
        self._shortest_ns = len(language.stop) * self._byte_ns
        """Time on the wire of the shortest motion frame, which is the one of zeros."""
        self.violations: list[str] = []
        self.causes: list[str] = []
        """The causes that the supervisor raised the epoch for, in order."""
        self.story: list[tuple[int, str]] = []
        self.moved_ns = 0
        """When the wheels were last told to turn."""
        self.hears_ns = 0
        """When a board that was deaf has heard one of the repeated zeros."""
        self.orderly = False
        """True while the service ends because it was asked to, so that its processes may die."""
        self._forbidden = "no program has asked for motion yet"
        """Why no frame may turn the wheels now; empty if one may."""
        self.asked_for_motion = 0
        """How often a program has asked for motion."""
        self._asking = False
        """A program has asked and has no answer yet."""
        self._asked_ns = 0
        """When a program last asked for motion."""
        self._commanding = self._commands = 0
        """How many programs are about to command, and how many commands there were."""
        self._silence = False
        """It is being waited for that no program commands."""
        self._stopper_paused_ns = (0, 0)
        """The begin and end of the last pause of a thread of the stopper."""
        self._fastest_rps = 0.0
        """The fastest speed that programs have commanded since they last asked for motion."""
        self.wire_ns = 0
        """When the board will have read everything written to it."""
        self._old_ns = 0
        """When it will have read everything from before motion was last granted, and everything that a port which did
        not drain had kept."""
        self._stops: dict[bool, tuple[int, int]] = {}
        """Early stops by threads of the port owner (True) and of others: when the stop is over, and how many frames may
        still turn the wheels after it, before a program asks for motion again."""
        self._begun: set[tuple[int, int]] = set()
        """The runs of the service, each by its supervisor's pid and with a port's number, that have written there."""
        self._late_ns: dict[str, int] = {}
        """Until when a thread of each process may pause."""
        self._paused_ns = Counter[str]()
        """How long threads of each process have paused in total; a bar is longer by that time."""
        self._cut_ns = 0
        """When half of a write was last on the wire."""
        self._fenced_ns = 0
        """Until when the stop for a fenced process may be on its way."""
        self._waits = ""
        """Why a program has to pause before it may turn the wheels; empty: none has."""
        self._late = False
        """True once the one frame has come that may follow a stop which was written while the port owner was held
        up."""
        robot.machine.on_event = self._on_event
        self.board.on_frame = self._frame
        self.board.on_bytes = self._written
        self.board.on_taken = self._taken

    def note(self, text: str) -> None:
        """Add a step to the story."""
        self.story.append((self.machine.now_ns, text))

    def wrong(self, text: str) -> None:
        """Add a violation."""
        if text not in self.violations:
            self.violations.append(text)
        self.note(f"WRONG: {text}")

    # Grants of motion, and reasons against it.

    def asks_for_motion(self) -> None:
        """A program calls enable()."""
        self.board.catch_up()
        self.asked_for_motion += 1
        self._asking, self._asked_ns = True, self.machine.now_ns
        self._forbidden, self._late = "", False
        self._stops = {}
        self.note("a program asks for motion")

    def _asks_still(self) -> None:
        if self._asking:
            self.asks_for_motion()

    def is_granted(self) -> None:
        """enable() has returned, so speeds count from now on, unless another program was driving."""
        self.board.catch_up()
        self._asking = False
        self._old_ns = max(self._old_ns, self.wire_ns)
        if not any(self.board.model.wheels):
            self._fastest_rps = 0.0

    def asks_for(self, rps: float) -> None:
        """A program commands this wheel speed."""
        self._fastest_rps = max(self._fastest_rps, rps)

    def commands(self) -> None:
        """A program begins to command a speed."""
        self._commanding += 1

    def commanded(self) -> None:
        """It has been commanded. If no command follows, the wheels stop by themselves."""
        self._commanding -= 1
        self._commands += 1
        if not self._silence:
            self._silence = True
            self._await_silence()

    def _await_silence(self) -> None:
        commands = self._commands

        def goes_on() -> bool:
            return self._commanding > 0 or self._commands != commands

        def due() -> None:
            if goes_on():
                self._await_silence()
                return
            self._silence = False
            self.note("no program commands")
            Deadline(self, "no program commands", SILENCE_BAR_NS, "gate", goes_on, forbids=False).begin(Phase.BAR)

        self.machine.at(self.machine.now_ns + COMMAND_COUNTS_NS, due)

    def _written(self, data: bytes) -> None:
        """Bytes for the board, written by the running thread. After an early stop by another process, the port owner
        may be about to write one frame (S2 of model/README.md); after one by its own thread, none. A stop by its
        loop is not early, and its reason may be over by itself."""
        begun_ns = max(self.wire_ns, self.machine.now_ns)
        self.wire_ns = begun_ns + len(data) * self._byte_ns
        if self.board.port and self.board.port.drained_ns == self.machine.now_ns:
            self._old_ns = self.wire_ns
        thread = self.machine.current
        if thread is None or self._asking or not data.startswith(self._first_stop):
            return
        own = thread.process.name == "port_owner"
        if own and thread is thread.process.threads[0]:
            return
        if thread.process.name == "stopper" and self._repeats_late():
            return
        self._stops.setdefault(own, (begun_ns + len(self._first_stop) * self._byte_ns, 0 if own else 1))

    def _taken(self, data: bytes) -> None:
        """What the kernel takes of the running thread's write. The first bytes of a run to each port are a stop, or as
        much of one as the kernel takes."""
        if self.machine.current is None:
            return
        writer = self.machine.current.process
        port, run = self.board.port, writer if writer.name == "supervisor" else writer.parent
        if port is None or run is None or (key := (run.pid, port.number)) in self._begun:
            return
        self._begun.add(key)
        if not (data.startswith(self._first_stop) or self._first_stop.startswith(data)):
            self.wrong(f"the first bytes of {run.name} (pid {run.pid}) to the board are no stop: {data[:16].hex(' ')}")

    def _repeats_late(self) -> bool:
        """Whether the stopper, which writes now, last looked before a program asked for motion, so that it repeats a
        stop from before that."""
        begun_ns, ended_ns = self._stopper_paused_ns
        return begun_ns <= self._asked_ns and self.machine.now_ns < ended_ns + RESUMED_NS

    def must_stop(self, why: str, within_ns: int, by: str = "", moot: Callable[[], bool] = lambda: False) -> None:
        """The wheels must be still within `within_ns`, until a program asks for motion again. Bytes that are on the
        wire go first, and so does a paused thread of a process that writes to the board, or of `by`, which notices.
        `moot`: whether nobody could notice."""
        self.note(why)
        after_ns = max(self.wire_ns, self.late_until_ns(by)) - self.machine.now_ns
        Deadline(self, why, within_ns, by, moot).begin(Phase.BAR, after_ns=after_ns)

    def must_be_still(self, why: str, within_ns: int, *, forbids: bool = True) -> None:
        """The deadline is over: the wheels are still, and if it `forbids` it no frame may turn them from now on."""
        if forbids:
            self._forbidden = self._forbidden or why
        if any(self.board.model.driven):
            self.wrong(f"the wheels turn {within_ns / MS:g} ms after: {why}")

    def late_until_ns(self, by: str = "") -> int:
        """Until when a thread of a process that writes to the board, or of `by`, may pause."""
        return max(self._late_ns.get(name, 0) for name in (*PORT_WRITERS, by))

    def all_paused_ns(self, by: str) -> int:
        """How long threads of these processes have paused, all in all."""
        return sum(self._paused_ns[name] for name in (*PORT_WRITERS, by))

    def must_refuse(self, why: str, within_ns: int) -> None:
        """From `within_ns` on no program may turn the wheels, until it asks for motion again. Whether they turn by
        themselves is not judged; nor is anything where the reports that show it are not what they should be."""
        self.note(why)
        asked, moot = self.asked_for_motion, self.blindness(COMPARED)

        def due() -> None:
            if self.asked_for_motion == asked and not moot():
                self._forbidden = self._forbidden or why

        self.machine.at(self.machine.now_ns + within_ns, due)

    def blindness(self, by: str) -> Callable[[], bool]:
        """Whether from now on there was ever a time in which it, one of the three above, could notice nothing."""
        begun_ns, paused_ns = self.machine.now_ns, self._paused_ns[by]
        return lambda: self._paused_ns[by] != paused_ns or self._late_ns.get(by, 0) > begun_ns

    def blind(self, ns: int, what: tuple[str, ...] = (ANY_REPORTS, TRUE_REPORTS, COMPARED)) -> None:
        """For so long these notice nothing: the board's reports are not what they should be, or nobody reads them."""
        for by in what:
            self._paused_ns[by] += ns
            self._late_ns[by] = max(self._late_ns.get(by, 0), self.machine.now_ns + ns)

    def must_wait(self, why: str) -> None:
        """No program may turn the wheels, until one asks for motion or a program is held up, which is a pause."""
        self._forbidden = self._forbidden or why
        self._waits = why

    def own_ns(self) -> int:
        """How much later than the first board this one may obey, from now on."""
        late_ns, port = self._traits.late_ns, self.board.port
        if not late_ns or port is None or not port.drained_ns:
            return late_ns
        return max(late_ns, port.drained_ns + ADAPTER_BAR_NS - self.machine.now_ns)

    def reached(self) -> bool:
        """True while a running process of the service has the board's port, the port takes bytes, and every process
        that is held up has been so for long enough that others noticed."""
        port = self.board.port
        living = (each for each in self._living() if not each.held_until_ns)
        if port is None or not port.drains or port.refuses or self.board.model.deaf or self._unnoticed():
            return False
        if self.machine.now_ns < max(self.hears_ns, self.late_until_ns(), self._fenced_ns):
            return False
        return any(_has(each, port) for each in living if each.name in PORT_WRITERS)

    def _unnoticed(self) -> bool:
        held = [each for each in self._living() if each.held_until_ns]
        names = {each.name for each in held}
        if names >= {"supervisor", "port_owner"}:
            # The stopper watches only the port owner, which is enough.
            bars = {**HANG_BAR_NS, "port_owner": STOPPER_NS, "supervisor": 0}
        else:
            bars = HANG_BAR_NS
        # A process that was held up does not count the time before it went on.
        watching_ns = max((each.resumed_ns for each in self._living() if each.name in PORT_WRITERS), default=0)
        noticed_ns = [max(each.held_since_ns, watching_ns) + bars.get(each.name, 0) for each in held]
        return any(self.machine.now_ns < at_ns for at_ns in noticed_ns)

    def _living(self) -> list[Process]:
        return [each for each in self.machine.processes.values() if not each.dead]

    def _frame(self, frame: Frame) -> None:
        if frame.func != MOTOR:
            return
        if any(frame.speeds):
            self.moved_ns = frame.executed_ns
            if self._forbidden and not self._was_on_its_way():
                self.wrong(f"a frame turns the wheels after: {self._forbidden}")
            for own, (stop_ns, more) in self._stops.items():
                # A frame that was written after the stop has all of its bytes after it.
                if frame.executed_ns >= stop_ns + self._shortest_ns:
                    self._stops[own] = stop_ns, more - 1
                    if more < 1:
                        self.wrong("a frame turns the wheels behind a stop that was written early")
            too_fast = max(map(abs, frame.speeds)) > self._fastest_rps + SLACK_RPS
            if too_fast and not self._asking and frame.executed_ns > self._old_ns and not self._may_be_fused():
                self.wrong(f"the wheels turn faster than a program asks for since it may: {frame.speeds}")
        if frame.wild:
            self.wrong(f"a frame writes outside of the motors: {frame.wild}")

    def _may_be_fused(self) -> bool:
        """Whether this frame may consist of pieces of two. On some boards such a frame passes the check, with any
        speed."""
        return self._fuses and self.machine.now_ns < self._cut_ns + self._traits.late_ns

    def _was_on_its_way(self) -> bool:
        """Allow the one frame of a port owner that was held up after its last look (S2 of model/README.md), which
        stops after it. A second frame is not allowed."""
        why, self._forbidden = self._forbidden, ""
        if self._late or not self._resumed():
            self._forbidden = why
            return False
        self._late = True
        self.must_stop(why, DEATH_NS)
        return True

    def _resumed(self) -> bool:
        """Whether a held-up port owner was released just now."""
        owner = self._robot.named("port_owner")
        return owner is not None and 0 < self.machine.now_ns - owner.resumed_ns < RESUMED_NS + self._traits.late_ns

    # Events of the machine.

    def _on_event(self, kind: str, process: Process, what: object) -> None:
        if kind == "failed":
            self.wrong(f"a thread of {process.name} ends with {type(what).__name__}: {what}")
        elif kind == "died":
            self.note(f"{process.name} (pid {process.pid}) dies: {what}")
            if process.held_until_ns:
                self._fenced_ns = self.machine.now_ns + DEATH_NS
            if process.name in SERVICE_PROCESSES and not self.orderly and not _is_left_over(process):
                self.must_stop(f"{process.name} is dead", DEATH_NS)
        elif process.name in SERVICE_PROCESSES:
            self.note(f"{process.name} (pid {process.pid}) starts")

    def held(self, process: Process, ns: int) -> None:
        """A process does not run for this time. That needs no stop while the wheels are stopped, nor while a program
        asks for motion, because its answer may come after it. A program that is held up in enable() may send its
        request only when it goes on."""
        self.board.catch_up()
        if process.name == "telemetry":
            self.blind(ns + SEES_AGAIN_NS, (COMPARED,))
        if process.name not in SERVICE_PROCESSES and self._waits == self._forbidden:
            self._forbidden = self._waits = ""
        if self._asking and process.name not in SERVICE_PROCESSES:
            self.machine.at(self.machine.now_ns + ns, self._asks_still)
        if ns > HANG_BAR_NS.get(process.name, ns) and any(self.board.model.wheels) and not self._asking:
            self.must_stop(f"{process.name} is silent", HANG_BAR_NS[process.name])
        else:
            self.note(f"{process.name} is held up for {ns / MS:g} ms")

    def late(self, process: Process, ns: int) -> None:
        """A thread of a process pauses for this time."""
        name = process.name
        self._paused_ns[name] += ns
        self._late_ns[name] = max(self._late_ns.get(name, 0), self.machine.now_ns + ns)
        if name == "stopper":
            self._stopper_paused_ns = self.machine.now_ns, self.machine.now_ns + ns

    def cut(self, told: str) -> None:
        """Half of a write is on the wire."""
        self.note(told)
        self._cut_ns = self.machine.now_ns

    def asked(self) -> None:
        """Bytes came to the stop pipe."""
        self.must_stop("a stop was asked for", ASKED_NS)


def _is_left_over(process: Process) -> bool:
    """True for a process whose supervisor died before it: that death was the one to stop for, and the next run of the
    service may be driving by now."""
    return process.name != "supervisor" and (process.parent is None or process.parent.dead)


def _has(process: Process, port: Port) -> bool:
    return any(opened.node is port for opened in process.files.values())

"""Stage: a scenario on a simulated robot, with its witness: start, what a program does, a fault on the way, the end.

After the scenario the faults are off: a run of the service is there, a program resets, enables and drives, and the
wheels turn within LIVE_NS. So a run is judged for what it forbids and for what it must allow. Last the machine freezes,
and a board that has a watchdog of its own stops the wheels by itself.
"""

from __future__ import annotations

import contextlib
import struct
import weakref
from collections.abc import Callable
from typing import Any

from failstop.messages import layout, records
from failstop.policy.layouts import BOARDS
from failstop.shm.cell import cell_bytes
from failstop_lab.machine.epoll import Epoll
from failstop_lab.machine.files import Regular
from failstop_lab.machine.kernel import FOREVER_NS, SIGCONT, SIGSTOP, SIGTERM
from failstop_lab.machine.loading import Patches
from failstop_lab.machine.mapped import Mapped
from failstop_lab.machine.memory import WeakMachine
from failstop_lab.machine.process import Process, Thread
from failstop_lab.machine.robot import COMMAND_EVERY_S, MS, Robot
from failstop_lab.simulate import coverage
from failstop_lab.simulate.order import Order, watch_looks, watch_rings
from failstop_lab.simulate.witness import (
    ANY_REPORTS,
    ASKED_NS,
    BACK_NS,
    COMMAND_COUNTS_NS,
    COMPARED,
    TRUE_REPORTS,
    ZEROS_NS,
    Witness,
)

Continuation = Callable[["Stage", Any], object]
SETTINGS: dict[Callable[[Stage], object], dict[str, object]] = {}
"""The settings of the scenarios that need some."""
NEEDS: dict[Callable[[Stage], object], frozenset[str]] = {}
"""The parts that the board must have for a scenario (lab/boards/traits.py), if it needs any."""
FROM_THE_START: set[Callable[[Stage], object]] = set()
"""The scenarios in which faults come before the service is ready."""
LONG_RUN: dict[str, object] = {"restart.deaths": 100_000, "restart.window_s": 1.0, "restart.backoff_s": 0.001}
"""Settings of a service on which many scenarios follow one another: its processes die more often than in any minute."""
SPEED_MPS = 0.1
RPS_PER_MPS = 3.98
SCENARIO_NS = 10_000 * MS
"""A scenario that takes longer has hung."""
OPENINGS = 4
"""At most so often in a scenario its port is opened: each time the board may be deaf first."""
READY_NS = 1_000 * MS
LIVE_NS = 2_000 * MS
WATCHDOG_LATE_NS = 60 * MS
"""Added to the time of a board's own watchdog: its loops, and the frames that are on the wire at a freeze."""
ARM_NS = 8_000 * MS
"""An arm has to go to its drive pose before the wheels may turn."""
RESTART_NS = 100 * MS
"""After its death the service is started again, as systemd does (RestartSec)."""
DRIVER_NS = 500 * MS
NOTICED_MS = 350
"""A board that is asked for its counters every 0.2 s may be told to drive again until the next answer."""
RUN_DOWN_MS = 300 + 200 + 100 + 200
"""From when a wheel runs away to the stop, with three times between reports: the lag, the shortest time that counts,
the run-down from SPEED_MPS at the default braking, and what the stop takes (procs/telemetry/runaway.md)."""
UNASKED_MS = 2 * 1_500 + 300
"""From when wheels turn unasked, which disables motion and then latches a stop, with some times between reports."""
SILENT_MS = 1_000
"""A board that says nothing any more is stopped within so long."""
SENSOR_MS, OPERATOR_MS = 525, 1_020
"""From the last delivery of the obstacle sensor or an interlock, and from the last proof of an operator, with the
default timeouts."""
LIMIT_MPS = 0.2
"""The default of limits.vx_mps."""
ATTENDED: dict[str, object] = {"attend.required": "on"}
INTERLOCKED: dict[str, object] = {"interlocks.bumper.timeout_s": 0.5}
OPERATOR, INTERLOCK = "ann", "bumper"
MOVING_AT = layout.SEGMENT_BY_NAME[layout.PORT_OWNER].offsets["moving"]
COMMAND_AT = layout.SEGMENT_BY_NAME["client.0"].offsets["command"]
CELL_NUMBER, CELL_TIME, COMMAND_SPEED = slice(8, 16), slice(16, 24), slice(32, 40)
"""Of a cell with a command: its number, its time, and the speed forward, behind the session."""
STOP_PIPE = "/run/failstop/failstop/stop"


class Stage:
    """`failstop` is the package as the simulated machine has it, `time` its clock."""

    def __init__(
        self,
        play: Callable[[Stage], object],
        seed: int = 0,
        patches: Patches = (),
        *,
        weak: bool = False,
        kind: str = BOARDS[0],
    ) -> None:
        """`weak`: loads and stores of shared memory are places for a fault too, and may come late. `kind`: the
        board's."""
        settings = {**(LONG_RUN if weak else {}), **SETTINGS.get(play, {})}
        self.robot = Robot(seed, imu_hz=20.0, settings=settings, patches=patches, kind=kind, weak=weak)
        self.machine = self.robot.machine
        self.traits = self.robot.board.traits
        self.ready_s = (READY_NS + self.traits.deaf_ns) / 1e9
        """Within so long a service whose processes all live is ready."""
        self.witness = Witness(self.robot)
        self.coverage = coverage.Coverage()
        coverage.watch(self.robot.loader, self.coverage, self.witness)
        if isinstance(self.machine, WeakMachine):
            watch_looks(self.robot.loader, Order(self.machine, self.witness))
            watch_rings(self.robot.loader, self.witness)
        self.failstop: Any = self.robot.loader.load("failstop")
        coverage.watch_commands(self.robot.loader, self.witness)
        self.time = self.robot.time
        self.load(play)
        self.hang_up_ns: Callable[[Epoll], int] = lambda epoll: 0
        """How much later who waits there hears of the loss of the port."""
        self.branch: Callable[[Continuation], Continuation] = lambda rest: rest
        """Asked at the end of what many scenarios begin with: what is to come then (scenarios.py, DRIVEN)."""
        self._drove: weakref.WeakSet[Any] = weakref.WeakSet()
        """The Robots that have commanded a speed. Weak, because one that nobody refers to gives its slot back; and not
        by their ids, because a new Robot may be where an old one was, by chance."""
        self._driver_drove = False
        """The wheels have turned for the last driver that was started."""
        self._begun = False
        self._granted_ns = FOREVER_NS
        """When the last program may drive."""
        self._keep = True
        self._enabled_by: Process | None = None
        """The supervisor of the run in which a program has enabled last."""
        self.silenced = False
        """The scenario has the board say nothing."""
        self.player: Process | None = None
        self._last: Process | None = None
        """The program that drives after the faults."""

    def load(self, play: Callable[[Stage], object]) -> None:
        """Play this scenario, on a robot that has its settings."""
        self._play = play
        told = SETTINGS.get(play, {})
        self.live_ns = ARM_NS if any(key.startswith("joints.") for key in told) else LIVE_NS
        # A port may be opened anew at its end, and once more by who starts then.
        self.live_ns += 2 * self.traits.deaf_ns
        self.attended = told.items() >= ATTENDED.items()
        self.interlocked = told.items() >= INTERLOCKED.items()
        self.explored = play in FROM_THE_START
        """Faults may come from now on. The start is the same in every scenario, so one has the faults of it."""

    # Acts of a scenario.

    def connect(self) -> Any:
        """A Robot of the run that is there, once there is one."""
        while True:
            try:
                robot = self.failstop.Robot()
                self.meet_conditions(robot)
                robot.wait_for("ready", self.ready_s)
            except (self.failstop.NoService, self.failstop.TimedOut):
                self.time.sleep(0.005)
            else:
                self.explored = True
                return robot

    def enable(self, robot: Any) -> None:
        """Reset where a stop is latched, and enable."""
        self.meet_conditions(robot)
        robot.wait_for("ready", self.ready_s)
        if robot.state.cause is not None:
            robot.reset()
        if robot in self._drove:
            robot.drive(0.0, 0.0, 0.0)  # else the enable would hold what it commanded just now
        self.witness.asks_for_motion()
        robot.enable()
        self.witness.is_granted()
        self._enabled_by = self.robot.named("supervisor")

    def drive(self, robot: Any, seconds: float, speed_mps: float = SPEED_MPS, *, sensed: bool = True) -> None:
        """Command a speed for so long, while the obstacle sensor delivers, or not. The settings limit the speed."""

        def asks() -> None:
            self.witness.asks_for(min(speed_mps, LIMIT_MPS) * RPS_PER_MPS)

        self._drove.add(robot)
        asks()
        self.robot.drive(robot, seconds, (speed_mps, 0.0, 0.0), asks, sensed=sensed)

    def meet_conditions(self, robot: Any) -> None:
        """Report an operator and assert an interlock, if motion needs them here."""
        if self.attended:
            robot.attend(OPERATOR)
        if self.interlocked:
            robot.assert_interlocks(INTERLOCK)

    def lose(self, what: str, within_ms: int) -> None:
        """The obstacle sensor, the interlock or the operator falls silent."""
        self.must_stop(f"{what} is silent", within_ms, layout.GATE)

    def stop(self, robot: Any, why: str = "hand near wheel") -> None:
        """Ask for a stop, and wait until it is latched."""
        robot.estop(why)
        self.witness.must_stop("a stop was asked for", ASKED_NS)
        robot.wait_for("latched", 1.0)

    def reset(self, robot: Any) -> None:
        """Clear the latch."""
        robot.wait_for("ready", self.ready_s)
        robot.reset()

    def disable(self, robot: Any) -> None:
        """Forbid motion."""
        robot.disable()
        self.must_stop("a program disabled motion", 30, layout.GATE)

    def must_stop(self, why: str, within_ms: int, by: str = "") -> None:
        """From then on the wheels stand, until a program asks for motion again; `by`: the process that notices."""
        self.witness.must_stop(why, within_ms * MS, by)

    def kill(self, name: str) -> None:
        """SIGKILL a process of the service."""
        self.robot.kill(name)

    def freeze(self, name: str, ms: int, *, starved: bool = False) -> None:
        """Run nothing of a process for so long; `starved`: for want of a processor."""
        if found := self.robot.named(name):
            self.witness.held(found, ms * MS)
            self.machine.hold(found, ms * MS, starved=starved)

    def unplug(self) -> None:
        self.witness.note("the plug is pulled")
        self.robot.unplug(self.hang_up_ns)

    def replug(self) -> None:
        self.robot.plug()
        self.witness.must_stop("the board is back", BACK_NS)

    def block_port(self) -> None:
        """The port keeps from now on what is written to it."""
        if self.robot.board.port:
            self.witness.note("the board takes no bytes")
            self.robot.board.port.drains = False

    def free_port(self) -> None:
        """The port passes on what it has kept."""
        if self.robot.board.port:
            self.robot.board.port.drain()
            self.must_stop("the port drains again", 30)

    def write_to_pipe(self, data: bytes) -> None:
        """Any bytes in the stop pipe."""
        system = self.robot.loader.system["os"]
        fd = system.open(STOP_PIPE, system.O_WRONLY)
        system.write(fd, data)
        system.close(fd)
        self.must_stop("bytes came to the stop pipe", 30)

    def remove_pipe(self) -> None:
        """Take the stop pipe away."""
        self.robot.loader.system["os"].unlink(STOP_PIPE)
        self.must_stop("the stop pipe was removed", 1_100)

    def start_driver(self, seconds: float) -> Process:
        """Another program, which drives for so long; returns when the wheels turn, or would long turn."""

        def drive(failstop: Any) -> None:
            with contextlib.suppress(failstop.FailstopError):
                self.drive(failstop.Robot(), seconds)

        began_ns = self.machine.now_ns
        driver = self.robot.program("driver.py", drive)
        while self.witness.moved_ns < began_ns and self.machine.now_ns < began_ns + DRIVER_NS:
            self.time.sleep(COMMAND_EVERY_S)
        self._driver_drove = self.witness.moved_ns >= began_ns
        return driver

    def kill_driver(self, driver: Process) -> None:
        """SIGKILL that program. One that has not driven yet may die without a stop."""
        self.machine.die(driver, -9)
        if self._driver_drove:
            self.must_stop("the program that drives is dead", 30, layout.GATE)

    def disturb_command(self, robot: Any) -> None:
        """Command what is no number, around the check of drive()."""
        robot._client().command(float("nan"), 0.0, 0.0, manual=False, source="cmd_vel")
        self.must_stop("a program commands what is no number", 30, layout.GATE)

    def damage_command(self, robot: Any) -> None:
        """A whole command with a forged speed comes into the program's memory. Only its CRC is wrong."""
        client = robot._client()
        at, size = COMMAND_AT, cell_bytes(records.COMMAND.most)
        name = f".client.{client.slot}"
        memory = self.machine.root.folder("/dev/shm").names
        file = next((node for path, node in memory.items() if path.endswith(name)), None)
        if not isinstance(file, Regular):
            return  # the service has ended
        cells = [file.get(at + number * size, size) for number in range(2)]
        newest = max(cells, key=lambda cell: int.from_bytes(cell[CELL_NUMBER], "little"))
        number = int.from_bytes(newest[CELL_NUMBER], "little") + 1
        forged = bytearray(newest)
        forged[CELL_NUMBER] = number.to_bytes(8, "little")
        forged[CELL_TIME] = self.machine.now_ns.to_bytes(8, "little")
        forged[COMMAND_SPEED] = struct.pack("<d", LIMIT_MPS)
        file.put(bytes(forged), at + number % 2 * size)

    def compete(self, *robots: Any) -> None:
        """These command one after the other under one source. If all of that takes longer than a command counts, they
        don't compete."""
        begun_ns = self.machine.now_ns
        for robot in robots:
            robot.sensed()
            robot.drive(SPEED_MPS / 2, 0.0, 0.0)
        if self.machine.now_ns - begun_ns < COMMAND_COUNTS_NS:
            self.must_stop("two programs command under one source", 30, layout.GATE)

    def hold_again(self, name: str, after_ms: int, ms: int, *, starved: bool = False) -> None:
        """As freeze, from a moment on that is so far away."""
        self.machine.at(self.machine.now_ns + after_ms * MS, lambda: self.freeze(name, ms, starved=starved))

    def hold_in_write(self, name: str, ms: int) -> None:
        """Run nothing of a process for so long, from its next write to the port on, whose bytes are then late."""
        board, heard = self.robot.board, self.robot.board.on_bytes

        def late(data: bytes) -> None:
            if found := self.robot.named(name):
                board.on_bytes = heard
                self.witness.held(found, ms * MS)
                self.machine.hold(found, ms * MS)
            heard(data)

        board.on_bytes = late

    def hold_as_it_moves(self, ms: int) -> None:
        """Starve the port owner for so long, from when it has said next that something moves."""
        machine = self.machine
        assert isinstance(machine, WeakMachine)
        told = machine.on_store

        def stored(thread: Thread, mapped: Mapped, at: int, made: int) -> None:
            if told:
                told(thread, mapped, at, made)
            if thread.process.name == layout.PORT_OWNER and at == MOVING_AT and mapped.data[at]:
                machine.on_store = told
                self.witness.held(thread.process, ms * MS)
                machine.hold(thread.process, ms * MS, starved=True)

        machine.on_store = stored

    def suspend(self, name: str, ms: int) -> None:
        """SIGSTOP, and SIGCONT after so long."""
        if found := self.robot.named(name):
            self.witness.held(found, ms * MS)
            self.machine.kill(found, SIGSTOP)
            self.machine.at(self.machine.now_ns + ms * MS, lambda: self.machine.kill(found, SIGCONT))

    def deafen(self) -> None:
        """The board hears nothing any more: it keeps its last speed, and nobody can stop it."""
        self.witness.note("the board hears nothing")
        self.robot.board.model.deaf = True

    def hear_again(self) -> None:
        """The board hears again. If it was to be stopped meanwhile, one of the repeated zeros does that."""
        self.witness.note("the board hears again")
        self.witness.hears_ns = self.machine.now_ns + ZEROS_NS
        self.robot.board.model.deaf = False

    def silence_board(self) -> None:
        """Nothing that the board says arrives any more; it hears and obeys."""
        self.must_stop("the board says nothing", SILENT_MS, ANY_REPORTS)
        self.robot.board.model.silent = self.silenced = True

    def run_away(self, faster: float) -> None:
        """The first wheel turns so many times as fast as it is told."""
        every_ms = self.traits.language.reports.judged_ns // MS
        self.must_stop("a wheel runs away", RUN_DOWN_MS + 3 * every_ms, COMPARED)
        self.robot.board.catch_up()
        self.robot.board.model.roll(faster, 0.0)

    def push(self, rps: float) -> None:
        """Somebody pushes the first wheel, or another program drives it, while the service tells it zero; 0: not any
        more. If it goes on, motion is disabled, and then a stop is latched."""
        if rps:
            every_ms = self.traits.language.reports.judged_ns // MS
            self.witness.must_refuse("the wheels turned although they were told zero", (UNASKED_MS + 4 * every_ms) * MS)
        self.robot.board.catch_up()
        self.robot.board.model.roll(1.0, rps)

    def enable_unseen(self, robot: Any) -> None:
        """Enable without a reset, after push(): nobody has seen why the wheels turned, so it is refused. In another run
        of the service motion was not enabled then, and it is an ask for motion like any other."""
        is_another = self.robot.named("supervisor") is not self._enabled_by
        if is_another:
            self.witness.asks_for_motion()
        with contextlib.suppress(self.failstop.FailstopError):
            robot.enable()
        if is_another:
            self.witness.is_granted()

    def enable_for(self, robot: Any) -> None:
        """Enable while that program commands a speed: it may turn no wheel until it has sent zero, or has paused."""
        self.witness.asks_for_motion()
        robot.enable()
        self.witness.is_granted()
        self.witness.must_wait("a program commands on through an enable")

    def lie(self, times: float, more_rps: float = 0.0) -> None:
        """The board reports that every wheel turns so many times as fast as it does, and by `more_rps` more."""
        self.witness.note("the board's reports lie" if (times, more_rps) != (1.0, 0.0) else "they are true again")
        self.robot.board.lie(times, more_rps)

    def delay_reports(self, ms: int) -> None:
        """What the board says arrives so much later."""
        self.witness.note(f"what the board says arrives {ms} ms late")
        self.robot.board.up_ns = ms * MS

    def restart_board(self, deaf_ms: int) -> None:
        """The board starts again, and hears and reports nothing for so long; its reports afterwards tell."""
        self.witness.note(f"the board restarts, deaf for {deaf_ms} ms")
        self.robot.board.restart(deaf_ms * MS)
        within_ns = (deaf_ms + NOTICED_MS) * MS
        moot = self.witness.blindness(TRUE_REPORTS)
        self.witness.must_stop("the board restarted", within_ns, layout.TELEMETRY, moot)

    def press(self, key: int) -> None:
        """A key of the board."""
        self.witness.must_stop("a key was pressed", 30 * MS, layout.TELEMETRY, self.witness.blindness(ANY_REPORTS))
        self.robot.board.press(key)

    def sleep_machine(self, seconds: float) -> None:
        """The machine sleeps: nothing runs, and CLOCK_MONOTONIC stands still."""
        self.machine.slept_ns += round(seconds * 1e9)
        self.witness.must_stop("the machine slept", 60 * MS)

    def end_service(self) -> None:
        """SIGTERM, as systemd sends it."""
        self._keep = False
        if found := self.robot.named("supervisor"):
            self.witness.orderly = True
            self.witness.must_stop("the service was told to end", 400 * MS)
            self.machine.kill(found, SIGTERM)
            while not found.dead:
                self.time.sleep(0.005)
            self.witness.orderly = False
        self._keep = True

    # The run.

    def run(self) -> None:
        """From the start of the service to the proof that it can drive again."""
        self.play()
        self.prove_alive()
        if self.traits.watchdog_ns and not self.witness.violations:
            self.prove_watchdog()

    def play(self, *, must_end: bool = True) -> None:
        """From the start of the service, if that was not begun before, to the end of the scenario. `must_end`: one that
        takes long is wrong, as it is not where a process may have died so often that it waits for a reset."""
        if not self._begun:
            self.begin()
        if self._last:
            self._end_last(self._last)
        self.player = self.robot.program("player.py", lambda failstop: self._played(failstop))
        player = self.player
        if not self.machine.run(lambda: player.dead, SCENARIO_NS + OPENINGS * self.traits.deaf_ns):
            if must_end:
                self.witness.wrong("the scenario does not come to its end")
            self.machine.die(player, -9)

    def _end_last(self, last: Process) -> None:
        """The wheels stand before another scenario begins: else what it does is judged by this program's drive."""
        machine, self._last = self.machine, None
        seam, machine.at_seam = machine.at_seam, None
        machine.die(last, -9)
        machine.run(lambda: not any(self.robot.board.model.wheels), LIVE_NS)
        machine.at_seam = seam

    def begin(self, warm_ns: int = 0) -> None:
        """Start the service, and let it run for so long."""
        self._begun = True
        self.robot.start()
        self._keep_running()
        self.machine.run(lambda: False, warm_ns)

    def _played(self, failstop: Any) -> None:
        try:
            self._play(self)
        except failstop.FailstopError as error:
            self.witness.note(f"the program is told: {error}")

    def _keep_running(self) -> None:
        """Start the service when there is none, for as long as the stage lives."""

        def look() -> None:
            if self._keep and not self.robot.named("supervisor"):
                self.robot.start()
            self.machine.at(self.machine.now_ns + RESTART_NS, look)

        self.machine.at(self.machine.now_ns + RESTART_NS, look)

    def prove_alive(self) -> None:
        """No faults any more: a program resets, enables, drives, and goes on with it."""
        machine, self._keep, self.witness.orderly = self.machine, True, False
        machine.at_seam = None
        for process in machine.processes.values():
            if process.held_until_ns:
                machine.resume(process)
        if self.robot.board.model.deaf:
            self.witness.hears_ns = machine.now_ns + ZEROS_NS
        self.robot.board.behave()
        self.silenced = False
        if self.robot.board.port is None:
            self.replug()
        else:
            self.robot.board.port.accept_again()
            if not self.robot.board.port.drains:
                self.robot.board.port.drain()
        self._granted_ns = FOREVER_NS
        last = self._last = self.robot.program("last.py", lambda failstop: self._drive_again(failstop))
        machine.run(lambda: self.witness.moved_ns > self._granted_ns or last.dead, self.live_ns)
        if self.witness.moved_ns <= self._granted_ns:
            self.witness.wrong(f"after all faults no program can drive within {self.live_ns / 1e9:g} s")

    def prove_watchdog(self) -> None:
        """While it drives nothing of the machine runs any more, and the board is alone."""
        board, watchdog_ns, self._keep = self.robot.board, self.traits.watchdog_ns + WATCHDOG_LATE_NS, False
        self.witness.note("the machine freezes for good")
        for process in self.machine.processes.values():
            self.machine.hold(process, FOREVER_NS)
        self.machine.run(lambda: False, watchdog_ns)
        board.catch_up()
        if any(board.model.wheels):
            self.witness.wrong(
                f"the board's own watchdog lets the wheels turn {watchdog_ns / MS:g} ms after the freeze"
            )

    def _drive_again(self, failstop: Any) -> None:
        while True:
            try:
                robot = failstop.Robot()
                if robot.state.cause is not None:
                    robot.reset()  # a process that is down starts again by it
                self.enable(robot)
                self._granted_ns = self.machine.now_ns
                while robot.state.enabled:
                    self.meet_conditions(robot)
                    self.drive(robot, COMMAND_EVERY_S)
            except failstop.FailstopError as error:
                self.witness.note(f"the last program is told: {error}")
                self.time.sleep(0.02)

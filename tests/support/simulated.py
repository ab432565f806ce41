"""The whole service on a simulated machine, its board and the test's own programs: what needs no kernel, in exact
times. Blocking calls of the test let the machine run; nothing else does.

`failstop` and what load() gives are of that machine. What a test imports itself asks the real one: it is fine for
constants and pure functions.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping
from typing import Any

from failstop.messages import layout
from failstop.policy.layouts import BOARDS
from failstop_lab.machine.kernel import SIGCONT, SIGSTOP, SIGTERM
from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import DEVICE, MS, Robot
from failstop_lab.machine.usb import Plug
from failstop_lab.sim import upward
from failstop_lab.sim.model import Frame, Speeds
from failstop_lab.sim.servos import Leg
from failstop_lab.stopped import Stopped, judge

FORWARD = (0.2, 0.0, 0.0)
LOOK_S, LOOK_SHARE = 0.001, 0.05
PATIENCE_S = 10.0
AFTERMATH_S = 0.25


class Board:
    """The board, as SimBoard has it; `link` is its port."""

    link = DEVICE

    def __init__(self, robot: Robot, wait_for: Callable[..., None]) -> None:
        self._robot, self._model, self._wait_for = robot, robot.board.model, wait_for
        self._cursor = 0

    def events(self) -> list[Frame]:
        self._robot.board.catch_up()
        found = self._model.executed(self._cursor)
        self._cursor += len(found)
        return found

    def wait_for(self, wanted: Callable[[Frame], object], timeout_s: float = PATIENCE_S) -> Frame:
        """The first such frame of those that events() has not returned; it returns them still."""
        found: list[Frame] = []

        def look() -> bool:
            found[:] = filter(wanted, self._model.executed(self._cursor))
            return bool(found)

        self._wait_for("a frame of the board", look, timeout_s)
        return found[0]

    def wheels(self) -> Speeds:
        self._robot.board.catch_up()
        return self._model.wheels

    def wait_wheels(self, *, turning: bool, timeout_s: float = PATIENCE_S) -> None:
        self._wait_for("the wheels", lambda: any(self.wheels()) == turning, timeout_s)

    def key(self, key_id: int, event: int) -> None:
        self._model.key(key_id, event, self._robot.machine.now_ns)
        self._robot.board.plan()

    def pad(self, buttons: int = 0, *, ly: int = 0, hold: bool = False) -> None:
        """One gamepad frame; with `hold` 20 a second."""
        self._model.pad(upward.gamepad_frame(buttons, ly=ly), self._robot.machine.now_ns, hold=hold)
        self._robot.board.plan()

    def pad_silent(self) -> None:
        self._model.pad_silent()

    def joints(self) -> dict[int, float]:
        now_ns = self._robot.machine.now_ns
        return {servo: found.leg.at(now_ns) for servo, found in self._model.servos.by_id.items()}

    def joint_track(self) -> list[Leg]:
        return list(self._model.servos.track)

    def servo(self, servo: int, **values: bool | float) -> None:
        self._model.servos.change(servo, self._robot.machine.now_ns, **values)

    def deaf(self, on: bool) -> None:
        self._model.deaf = on

    def silent(self, on: bool) -> None:
        self._model.silent = on

    def refuse_stop(self, on: bool) -> None:
        self._model.refuse_stop = on

    def roll(self, faster: float = 1.0, pushed_rps: float = 0.0) -> None:
        model = self._model
        self._robot.board.catch_up()
        model.roll(faster, pushed_rps)

    def lie(self, times: float = 1.0) -> None:
        self._robot.board.lie(times)

    def imu(self, on: bool) -> None:
        self._model.imu_on = on

    def restart(self, deaf_s: float) -> None:
        """It starts again, as after a dip of its supply, and for so long it hears and reports nothing."""
        self._robot.board.restart(round(deaf_s * 1000) * MS)

    def unplug(self) -> None:
        self._robot.unplug()

    def replug(self) -> None:
        self._robot.plug()


class Mistake(Exception):
    """An error that a test's own program is to end by."""


class Simulated:
    """A service that runs, its board, and a client that drives it. Where a real one needs no kernel, its calls are
    Trial's."""

    name = "failstop"
    link = DEVICE

    def __init__(
        self,
        settings: Mapping[str, object] | None = None,
        imu_hz: float = 20.0,
        *,
        deaf: bool = False,
        kind: str = BOARDS[0],
        usb: Plug | None = None,
        motors: int = 0,
    ) -> None:
        """`deaf`: the board hears nothing, from the start; `kind`: the board's; `usb`: its device on USB; `motors`: how
        many it has, 0: as usual."""
        self.lab = Robot(imu_hz=imu_hz, settings=dict(settings or {}), kind=kind, usb=usb, motors=motors)
        self.own_ns = self.lab.board.traits.late_ns
        """Later than the first board by so much a stop may be, and motion."""
        self.failed: list[BaseException] = []
        self.lab.machine.on_event = self._on_event
        self.me = self.lab.join("test")
        self.pid = self.me.pid
        self.load, self.os, self.time = self.lab.loader.load, self.lab.loader.system["os"], self.lab.time
        self.failstop = self.load("failstop")
        self.board = Board(self.lab, self.wait_for)
        self.board.deaf(deaf)
        self._robot: Any = None
        self._drove = False
        self.start()

    def _on_event(self, _kind: str, _process: Process, what: object) -> None:
        if isinstance(what, BaseException) and not isinstance(what, Mistake):
            self.failed.append(what)

    # Time.

    def now_ns(self) -> int:
        return self.lab.machine.now_ns

    def wait(self, seconds: float) -> None:
        self.time.sleep(seconds)

    def wait_for(self, what: str, check: Callable[[], object], timeout_s: float = PATIENCE_S) -> None:
        """Look until `check` is true: every millisecond, and in a long wait after each twentieth of it."""
        waited_s, begun_ns = 0.0, self.now_ns()
        while not check():
            assert waited_s <= timeout_s, f"waited {timeout_s:g} s for {what}"
            self.wait(max(LOOK_S, waited_s * LOOK_SHARE))
            waited_s = (self.now_ns() - begun_ns) / 1e9

    # The service.

    def start(self) -> None:
        """Start the service; returns when nothing of it is waited for."""
        self.lab.start()
        self.leave()
        self.lab.connect().close()

    def end(self, number: int = SIGTERM) -> int | None:
        """A signal to the supervisor; returns the exit code."""
        supervisor = self._of("supervisor")
        self.lab.machine.kill(supervisor, number)
        self.wait_for("the end of the service", lambda: supervisor.code is not None)
        return supervisor.code

    @property
    def said(self) -> str:
        return self.lab.said

    def pids(self) -> dict[str, int]:
        return {name: row.pid for name, row in self.robot.state.processes.items()}

    def living(self) -> list[str]:
        return [each.name for each in self.lab.machine.processes.values() if self._lives(each)]

    @staticmethod
    def _lives(process: Process) -> bool:
        return process.name in layout.PROCESS_NAMES and process.code is None

    def _of(self, name: str) -> Process:
        found = self.lab.named(name)
        assert found, f"no process {name} lives"
        return found

    def die(self, name: str) -> None:
        self.lab.machine.die(self._of(name), -9)

    def suspend(self, name: str) -> None:
        self.lab.machine.kill(self._of(name), SIGSTOP)

    def resume(self, name: str) -> None:
        self.lab.machine.kill(self._of(name), SIGCONT)

    def hold(self, name: str, seconds: float, *, starved: bool = False) -> None:
        self.lab.machine.hold(self._of(name), round(seconds * 1000) * MS, starved=starved)

    def kill(self, name: str, drive_s: float = 0.15) -> Stopped:
        """SIGKILL a process while driving; the client goes on commanding."""
        self.drive(drive_s)
        self.board.events()
        was_turning, fault_ns = self.turning(), self.now_ns()
        self.die(name)
        self.drive(AFTERMATH_S)
        return judge(self.board.events(), fault_ns, was_turning)

    def stops(self, fault_ns: int, within_ms: float) -> int:
        """Check that the board has executed a stop for a fault in time, and no motion since; how many stop frames."""
        events = self.board.events()
        found = judge(events, fault_ns, was_turning=True)
        assert found.stop_ns is not None
        assert found.stop_ns <= within_ms * MS
        assert (found.still_ns is None, found.motion_after) == (False, 0)
        return sum(event.is_stop for event in events)

    def recover(self, name: str, pid: int) -> None:
        """Wait until the service is whole again, with another process of this name; a supervisor is started here."""
        if name == "supervisor":
            self.wait_for("the last process to end", lambda: not self.living())
            self.start()
        else:
            self.wait_for("another process", lambda: self.pids()[name] != pid)
            self.wait_for("a whole service", lambda: self.robot.state.waiting_for is None)

    # Its clients.

    @property
    def robot(self) -> Any:
        """The driving client, connected to the run that is there now."""
        if self._robot is None:
            self._robot = self.failstop.Robot(client="trial", disable_on_exit=False)
        return self._robot

    def leave(self) -> None:
        if self._robot:
            self._robot.close()
            self._robot = None

    def command(self, *words: str, each: Callable[[], object] = lambda: None) -> tuple[int, str, str]:
        """Run `failstop ...`, calling `each` every 20 ms meanwhile; (exit code, what it printed, its errors)."""
        return self.lab.command(words, each)

    def printed(self, *words: str) -> str:
        """The output of a command that has nothing to complain of, as one line."""
        code, out, err = self.command(*words)
        assert (code, err) == (0, "")
        return " ".join(out.split())

    def json(self, *words: str, each: Callable[[], object] = lambda: None) -> Any:
        code, out, err = self.command(*words, "--json", each=each)
        assert (code, err) == (0, "")
        return json.loads(out)

    def program(self, name: str, body: Callable[[Any], object]) -> Process:
        """Start another program, which is called with its `failstop`."""
        return self.lab.program(name, body)

    def driver(self, client: str, velocity: tuple[float, float, float] = FORWARD, **options: object) -> Process:

        def drive(failstop: Any) -> None:
            with failstop.Robot(client=client) as robot:
                while True:
                    robot.sensed()
                    robot.drive(*velocity, **options)
                    self.time.sleep(0.02)

        return self.program(client, drive)

    def enable(self) -> None:
        """Reset what is latched, as soon as its stop has been carried out, and enable motion."""
        if self.robot.state.estop:
            self.wait_for("a reset to be taken", self.reset)
        self.let_go()
        self.robot.enable()

    def let_go(self) -> None:
        """Command zero if this program commanded a velocity just now: else the next enable would hold it."""
        if self._drove:
            with contextlib.suppress(self.failstop.FailstopError):
                self.robot.drive(0.0, 0.0, 0.0)
            self._drove = False

    def reset(self) -> bool:
        """True once a reset was taken: one that a stop has come before is refused."""
        try:
            self.robot.reset()
        except self.failstop.Refused:
            return False
        return True

    def drive(
        self, seconds: float, velocity: tuple[float, float, float] = FORWARD, each: Callable[[], object] = lambda: None
    ) -> None:
        """Command a velocity every 20 ms, calling `each` every time; a service that is gone is commanded in vain."""
        self._drove = True
        until_ns = self.now_ns() + round(seconds * 1e9)
        while self.now_ns() < until_ns:
            try:
                self.lab.drive(self.robot, (until_ns - self.now_ns()) / 1e9, velocity, each)
            except self.failstop.FailstopError:
                self.wait(0.02)

    def set_off(self) -> None:
        """Drive forward; the board's past is forgotten."""
        self.enable()
        self.drive(0.2)
        assert self.turning()
        self.board.events()

    def turning(self) -> bool:
        return any(self.board.wheels())

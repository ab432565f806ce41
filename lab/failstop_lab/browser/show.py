"""Show: the service on the simulated machine as the page of the documentation has it, with a program that drives.

The processes, the API and the words are those that ship (lab/failstop_lab/simulate/README.md). The page presses the
buttons of acts.py, lets time pass and shows what comes of it.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections import deque
from collections.abc import Callable
from typing import Any

from failstop.board.rrc.framing import MOTOR
from failstop.messages.layout import PROCESS_NAMES, SUPERVISOR
from failstop.policy.settings import FIRST_SOURCE, PAD_SOURCE
from failstop_lab.browser.acts import ACTS, GROUPS, HANG_PREFIX, KILL_PREFIX, SWITCHES
from failstop_lab.machine.kernel import SIGCONT, SIGKILL, SIGSTOP, SIGTERM
from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import MS, Robot
from failstop_lab.sim import upward
from failstop_lab.sim.model import commands_stop
from failstop_lab.sim.receiver import Receiver

INTERLOCK = "arm"
SETTINGS: dict[str, object] = {f"interlocks.{INTERLOCK}.timeout_s": 0.5, "restart.deaths": 1000}
"""A reader may kill processes as often as they like: it is no crash loop here."""
SPEED = (0.2, 0.0, 0.0)
NO_SPEED = (0.0, 0.0, 0.0)
EVERY_S = 0.02
IMU_HZ = 50.0
RESTART_NS, WATCHDOG_NS = 100 * MS, 1000 * MS
"""RestartSec and WatchdogSec of the systemd unit."""
NAP_NS = 20_000 * MS
FROZEN_NS = 300 * MS
STEP_NS = 3600 * 1000 * MS
STOP_PIPE = "/run/failstop/failstop/stop"
STOP_KEY, PRESSED, PAD_BUTTON = 1, 0x01, 0x0100
GARBAGE = b"garbage"
CLAIM_SEEN_S = 0.06
"""The gate looks at claims once a tick."""
LINES, EVENT_LINES = 12, 12
"""Lines of the wire, and events, that are shown."""
ZEROS, TURNING = "every wheel to zero", "motion"
UNIX_S = 1_700_001_000
"""The time of day at which a machine starts."""


class Show:
    """A robot that is driven. Its service starts at once; time passes in turn() alone."""

    def __init__(self) -> None:
        self.robot = Robot(imu_hz=IMU_HZ, settings=SETTINGS)
        self.machine = self.robot.machine
        self.on = dict.fromkeys(SWITCHES, True)
        self.answer = ""
        """The answer to the last request."""
        self._wire: deque[list[Any]] = deque(maxlen=LINES)
        self._receiver = Receiver()
        self.robot.board.on_bytes = self._sent
        self.robot.join("page")
        load = self.robot.loader.load
        self._view, self._why = load("failstop.web.view"), load("failstop.api.why")
        self._follower_of = load("failstop.api.follow").Follower
        self._refused = load("failstop.api.errors").FailstopError
        self._follower: Any = None
        self._note = ""
        self._suspended: dict[str, Process] = {}
        """The processes that hang, by their switch."""
        self._began_ns = self.machine.now_ns
        self.robot.start()
        self._keep_running()
        self._each("sensors", self._sense)
        self._speed = NO_SPEED
        self._driver = self._each("driver", self._drive)

    # The machine around the service, and its programs.

    def _keep_running(self) -> None:
        """Start the service where there is none, and end a supervisor that is silent, as systemd does."""
        found, hung = self.robot.named(SUPERVISOR), self._suspended.get(HANG_PREFIX + SUPERVISOR)
        if found is None:
            self.robot.start()
        elif found is hung and self.machine.now_ns - found.held_since_ns > WATCHDOG_NS:
            self.machine.die(found, -SIGKILL)
        self.machine.at(self.machine.now_ns + RESTART_NS, self._keep_running)

    def _each(self, name: str, body: Callable[[Any], object]) -> Process:
        """Start a program that calls `body` with a Robot every 20 ms, whatever that raises."""

        def run(failstop: Any) -> None:
            robot = None
            while True:
                with contextlib.suppress(failstop.FailstopError):
                    robot = robot or failstop.Robot(client=name)
                    body(robot)
                self.robot.time.sleep(EVERY_S)

        return self.robot.program(name, run)

    def _once(self, name: str, body: Callable[[Any], object]) -> None:
        """Start a program that does one thing, and keep what it is answered."""

        def run(failstop: Any) -> None:
            try:
                self.answer = str(body(failstop) or "")
            except failstop.FailstopError as error:
                self.answer = str(error)

        self.robot.program(name, run)

    def _sense(self, robot: Any) -> None:
        if self.on["sensor"]:
            robot.sensed()
        robot.assert_interlocks(*(INTERLOCK,) * self.on["interlock"])

    def _drive(self, robot: Any) -> None:
        """As a good program does: zero until motion is enabled, since an enable holds whoever commands a velocity."""
        if self.on["commands"]:
            answer = robot.drive(*self._speed, wait_s=0)
            block = getattr(answer, "block", None)
            self._speed = NO_SPEED if block and block.name in ("LATCHED", "DISABLED", "HELD") else SPEED

    # The acts.

    def act(self, name: str) -> None:
        """Press a button, or turn a switch over. Raises KeyError."""
        self.answer = ""
        if name in self.on:
            self.on[name] = not self.on[name]
            self._switched(name, self.on[name])
        elif name.startswith(KILL_PREFIX):
            self.robot.kill(name.removeprefix(KILL_PREFIX))
        else:
            ACT_BODIES[name](self)

    def _switched(self, name: str, on: bool) -> None:
        board = self.robot.board
        if name.startswith(HANG_PREFIX) or name == "driver":
            process = self._driver if name == "driver" else self.robot.named(name.removeprefix(HANG_PREFIX))
            self._suspended.pop(name, None)
            if process:
                self.machine.kill(process, SIGCONT if on else SIGSTOP)
                self._suspended.update({} if on else {name: process})
        elif name == "plug":
            self.on["drains"] = True
            if on:
                self.robot.plug()
            else:
                self.robot.unplug()
        elif name == "hears":
            board.model.deaf = not on
        elif name == "obeys":
            board.model.refuse_stop = not on
        elif name == "drains" and board.port:
            board.port.drains = on
            if on:
                board.port.drain()

    def _kill_driver(self) -> None:
        self.machine.die(self._driver, -SIGKILL)
        self._speed = NO_SPEED
        self._driver = self._each("driver", self._drive)

    def _command(self, vx: float, source: str = FIRST_SOURCE) -> None:
        """Command once, past the checks of the API, from a program of its own."""

        def command(failstop: Any) -> None:
            client = failstop.Robot(client="second")._client()
            self.robot.time.sleep(CLAIM_SEEN_S)
            client.command(vx, 0.0, 0.0, manual=False, source=source)
            self.robot.time.sleep(CLAIM_SEEN_S)

        self._once("second", command)

    def _write_to_pipe(self) -> None:
        system = self.robot.loader.system["os"]

        def write(failstop: Any) -> None:
            fd = system.open(STOP_PIPE, system.O_WRONLY)
            system.write(fd, GARBAGE)
            system.close(fd)

        self._once("garbage", write)

    def _press(self, frame: bool) -> None:
        model, now_ns = self.robot.board.model, self.machine.now_ns
        if frame:
            model.key(STOP_KEY, PRESSED, now_ns)
        else:
            model.pad(upward.gamepad_frame(PAD_BUTTON), now_ns, hold=False)
        self.robot.board.plan()

    def _freeze(self) -> None:
        for name in PROCESS_NAMES:
            if found := self.robot.named(name):
                self.machine.hold(found, FROZEN_NS)

    def _sleep(self) -> None:
        self.machine.slept_ns += NAP_NS

    def _step_clock(self) -> None:
        self.machine.unix_ns += STEP_NS

    def _end(self) -> None:
        if found := self.robot.named(SUPERVISOR):
            self.machine.kill(found, SIGTERM)

    # The page's view of it.

    def turn(self, seconds: float) -> None:
        """Let time pass."""
        self.robot.time.sleep(seconds)

    def _sent(self, data: bytes) -> None:
        """Keep bytes that went out to the board, as frames: equal ones of one process are a line."""
        current = self.machine.current
        who = current.process.name if current else "kernel"
        for _, func, found in self._receiver.feed(data):
            if func != MOTOR:
                continue  # it asks whether the board listens
            what = ZEROS if commands_stop(func, found) else TURNING
            last = self._wire[-1] if self._wire else None
            if last and last[1:3] == [who, what]:
                last[3:] = last[3] + 1, found.hex(" ")
            else:
                self._wire.append([self._time(), who, what, 1, found.hex(" ")])

    def _time(self) -> float:
        return round((self.machine.now_ns - self._began_ns) / 1e9, 4)

    def _read(self) -> Any:
        """The state, or None while no service runs."""
        now_s = self.robot.time.monotonic()
        try:
            self._follower = self._follower or self._follower_of("failstop")
        except self._refused as error:
            self._note = str(error)
            return None
        state = self._follower.read(now_s)
        self._note = self._follower.note
        return state

    def shown(self) -> dict[str, Any]:
        """Values that the page draws: words of the operator's page and of `failstop why`, the wire and the wheels."""
        state, now_s = self._read(), self.robot.time.time()
        events = self._follower.events if self._follower else []
        view = self._view.absent(self._note) if state is None else self._view.view(state, events, now_s)
        rows = self._why.explain(state, events, now_s).rows() if state else [("what", self._note)]
        cause = state.cause if state else None
        self.robot.board.catch_up()
        self.on.update((name, True) for name, process in self._suspended.items() if process.dead)
        return {
            "time": self._time(),
            "view": {key: view[key] for key in ("word", "role", "enabled", "can", "processes")},
            "why": [[label, text.replace("`", "")] for label, text in rows],
            "cause": cause and {"name": cause.kind.name, "arguments": list(cause.arguments), "text": str(cause)},
            "events": [[event.t - UNIX_S, event.level, event.text] for event in events[-EVENT_LINES:]],
            "wire": list(self._wire),
            "wheels": [round(speed, 2) for speed in self.robot.board.model.wheels],
            "on": self.on,
            "answer": self.answer,
        }

    def json(self) -> str:
        """shown(), for JavaScript."""
        return json.dumps(self.shown())


ACT_BODIES: dict[str, Callable[[Show], object]] = {
    "enable": lambda show: show._once("you", lambda failstop: failstop.Robot(disable_on_exit=False).enable()),
    "reset": lambda show: show._once("you", lambda failstop: failstop.Robot().reset()),
    "disable": lambda show: show._once("you", lambda failstop: failstop.Robot().disable()),
    "stop": lambda show: show._once("you", lambda failstop: failstop.Robot(client="you").estop("hand near wheel")),
    "stop-pipe": Show._write_to_pipe,
    "driver-killed": Show._kill_driver,
    "driver-nan": lambda show: show._command(math.nan),
    "driver-second": lambda show: show._command(0.1),
    "driver-gamepad": lambda show: show._command(0.0, PAD_SOURCE),
    "key": lambda show: show._press(True),
    "pad": lambda show: show._press(False),
    "sleep": Show._sleep,
    "freeze": Show._freeze,
    "clock": Show._step_clock,
    "end": Show._end,
}


def table() -> str:
    """The acts for JavaScript, in their groups."""
    return json.dumps([[group, [act._asdict() for act in ACTS if act.group == group]] for group in GROUPS])

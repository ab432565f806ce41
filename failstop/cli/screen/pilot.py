"""Pilot: what the keys of `failstop teleop` do to the robot."""

from __future__ import annotations

import os
import signal
import threading

from failstop.api.errors import FailstopError, NoService
from failstop.cli.screen.hold import AXES, COMMAND_S, Hold
from failstop.cli.screen.keys import EVENTS, FOCUS_OUT, PRESS, RELEASE
from failstop.cli.style import FAIL, OK, PLAIN, WARN
from failstop.procs.gate.arm.joints import PULSES_PER_RAD
from failstop.shm import blocks

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.robot import Robot
    from failstop.api.state import State
    from failstop.cli.screen.hold import Velocity
    from failstop.cli.screen.keys import Key

CLIENT = "failstop teleop"
LATCHED = "a stop is latched: r resets it, then e enables motion"
STEP_PERCENT = 10
FIRST_PERCENT = 50
FASTER = ("+", "=")
SLOWER = ("-", "_")
LEAVE = ("q", "ctrl+d")
TURNS = {"[": -1, "]": 1}
"""These turn the chosen joint of the arm, which a digit chooses, while they are held."""
URGENT = ("space", *LEAVE, "ctrl+c", "ctrl+z", EVENTS, FOCUS_OUT)
"""These count however late they come."""
SIGNALS = {"ctrl+c": signal.SIGINT, "ctrl+z": signal.SIGTSTP}
"""Terminals that tell all keys as events send these too, which the kernel then makes no signals of."""


class Pilot:
    """Keys in, requests and commands out. A request that fails is a note on the screen; a service that has gone is
    raised as NoService."""

    def __init__(self, robot: Robot, source: str, speed_mps: float, turn_radps: float) -> None:
        """The speeds are those at 100 %."""
        self.robot = robot
        self.source = source
        self.percent = FIRST_PERCENT
        self.hold = Hold()
        self.note = ("motion is never enabled by itself: e enables it", PLAIN)
        """What to tell, and its role."""
        self.leaving = False
        self._full = (speed_mps, speed_mps, turn_radps)
        self._command: Velocity = (0.0, 0.0, 0.0)
        self._commanded_s = 0.0
        self.joint = 0
        """The chosen joint of the arm, by its place in the settings."""
        self._has_arm = False
        self._enabling: threading.Thread | None = None
        self._latched: str | None = None
        """The latch as it was seen last."""
        self._rival = ""
        """Who else commands as this source."""
        self._who = f"{CLIENT} (pid {os.getpid()})"

    def speeds(self) -> tuple[float, float]:
        """What a held key commands now: m/s, rad/s."""
        return self._full[0] * self.percent / 100, self._full[2] * self.percent / 100

    def command(self, now_s: float) -> Velocity | None:
        """The last command while it counts."""
        return self._command if now_s - self._commanded_s <= COMMAND_S else None

    def keys(self, keys: list[Key], state: State, now_s: float, *, late: bool) -> None:
        """Act on key events. `late`: they may have waited somewhere; then only what stops counts."""
        self._has_arm = state.arm is not None
        others = (row.who for row in state.sources if row.source == self.source and row.who != self._who)
        self._rival = next(others, "")
        if ("space", PRESS) in keys:
            self._request("space")
            late = True  # what was typed before it, or with it, must not undo it
        if late:
            self._send(self.hold.let_go(), now_s)
            keys = [key for key in keys if key[0] in URGENT]
        if state.arm:
            keys = [key for key in keys if not self._turn(key, list(state.arm.joints))]
        for name, kind in keys:
            if kind != RELEASE and name not in AXES and name != "space":
                self._press(name, now_s)
        moving = [key for key in keys if key[0] in AXES or key[0] == FOCUS_OUT]
        if moving and self._may_drive(moving, state):
            self._send(self.hold.events(moving, now_s), now_s)
        self.tick(state, now_s)

    def tick(self, state: State, now_s: float) -> None:
        """What is due without a key; nothing drives on that something else has stopped."""
        if not state.enabled:
            self.hold.let_go()
        if state.estop != self._latched:
            self._latched = state.estop
            if state.estop:
                self.note = (LATCHED, FAIL)
        self._send(self.hold.due(now_s), now_s)

    def _press(self, name: str, now_s: float) -> None:
        """A key that is none of motion; one that means nothing lets go of those that are."""
        if name == EVENTS:
            self.hold.releases = True
        elif name == FOCUS_OUT:
            return
        elif name in FASTER or name in SLOWER:
            change = STEP_PERCENT if name in FASTER else -STEP_PERCENT
            self.percent = max(STEP_PERCENT, min(100, self.percent + change))
        elif name in SIGNALS:
            os.kill(os.getpid(), SIGNALS[name])
        else:
            self._send(self.hold.let_go(), now_s)
            self._request(name)

    def _turn(self, key: Key, joints: list[str]) -> bool:
        """True when the key is one of the arm's: acted on."""
        name, kind = key
        if name.isdigit() and 0 < int(name) <= len(joints):
            self.joint = int(name) - 1
            self.note = (f"joint {joints[self.joint]}: [ and ] turn it", PLAIN)
        elif name in TURNS:
            self._jog(joints[min(self.joint, len(joints) - 1)], TURNS[name] if kind != RELEASE else 0)
        else:
            return False
        return True

    def _jog(self, joint: str, way: int) -> None:
        try:
            arm = self.robot.arm
            if way:
                arm.jog({joint: way * arm.joints[joint].speed / PULSES_PER_RAD * self.percent / 100})
                self.note = (arm.state.closed or f"joint {joint}", PLAIN)
            else:
                arm.hold()
        except NoService:
            raise
        except FailstopError as error:
            self.note = (str(error), FAIL)

    def _enable(self) -> None:
        """Beside the keys, since with an arm it takes seconds: the space key must stop meanwhile."""
        if self._enabling and self._enabling.is_alive():
            return

        def enable() -> None:
            try:
                self.note = (self.robot.enable(self._tell), OK)
            except FailstopError as error:
                self.note = (str(error), FAIL)

        self._enabling = threading.Thread(target=enable, daemon=True)
        self._enabling.start()

    def _tell(self, text: str) -> None:
        self.note = (text, PLAIN)

    def _request(self, name: str) -> None:
        try:
            if name == "space":
                self.hold.let_go()
                self.robot.estop("space key")
                self.note = (LATCHED, FAIL)
            elif name == "e" and self._has_arm:
                self._enable()
            elif name == "e":
                self.note = (self.robot.enable(), OK)
            elif name == "r":
                self.note = (self.robot.reset(), WARN)
            elif name in LEAVE:
                self.leaving = True
        except NoService:
            raise
        except FailstopError as error:
            self.note = (str(error), FAIL)

    def _may_drive(self, keys: list[Key], state: State) -> bool:
        """False, with a note, when a press could not move the wheels, or would stop everything: a second publisher of a
        source is a reason to latch."""
        pressed = any(name in AXES and kind != RELEASE for name, kind in keys)
        if not pressed:
            return True
        if state.estop:
            self.note = (LATCHED, FAIL)
        elif not state.enabled:
            self.note = ("motion is disabled: e enables it", WARN)
        elif self._rival:
            self.note = (f"{self._rival} drives as {self.source}: end it, or use --source with another one", WARN)
        else:
            if self.note[1] in (WARN, FAIL) and state.blocked in (None, blocks.NO_COMMAND):
                self.note = ("", PLAIN)
            return True
        self.hold.let_go()
        return False

    def _send(self, wanted: Velocity | None, now_s: float) -> None:
        """Not even a zero goes out beside another publisher of the source: that would latch a stop."""
        if wanted is None or self._rival:
            return
        x, y, turn = (part * full * self.percent / 100 for part, full in zip(wanted, self._full, strict=True))
        self._command, self._commanded_s = (x, y, turn), now_s
        self.robot.drive(x, y, turn, manual=True, source=self.source)

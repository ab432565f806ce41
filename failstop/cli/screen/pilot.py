"""Pilot: what the keys of `failstop teleop` do to the robot, and the screen of it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from failstop.api import words
from failstop.api.errors import FailstopError, NoService
from failstop.api.robot import Robot
from failstop.api.snapshot import ArmState
from failstop.api.state import State
from failstop.cli.screen import summary
from failstop.cli.screen.keys import AXES, COMMAND_S, EVENTS, FOCUS_OUT, PRESS, RELEASE, Hold, Key, Velocity
from failstop.cli.screen.summary import row
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN, Line, Span
from failstop.procs.gate.arm.joints import PULSES_PER_RAD
from failstop.shm import blocks

CLIENT = "failstop teleop"
LATCHED = ("a stop is latched: r resets it, then e enables motion", FAIL)
FIRST_PERCENT = 50
STEPS_PERCENT = {"+": 10, "=": 10, "-": -10, "_": -10}
LEAVE = ("q", "ctrl+d")
TURNS = {"[": -1, "]": 1}
"""These turn the chosen joint of the arm, which a digit chooses, while they are held."""
URGENT = ("space", *LEAVE, "ctrl+c", "ctrl+z", EVENTS, FOCUS_OUT)
"""These count however late they come."""
SIGNALS = {"ctrl+c": signal.SIGINT, "ctrl+z": signal.SIGTSTP}
"""Terminals that tell all keys as events send these too, which the kernel then makes no signals of."""
KEYS = (
    ("w s", "\u2191 \u2193", "forward, backward", "space", "STOP, latched"),
    ("a d", "\u2190 \u2192", "turn left, right", "e", "enable motion"),
    ("j l", "", "slide left, right", "r", "reset a latched stop"),
    ("+ -", "", "faster, slower", "q", "stop, disable, leave"),
)
"""Two columns of keys: letters, arrows, what they do; another key, what it does."""
REPEATS = "hold a key to drive: a tap drives 0.3 s, going on when the terminal repeats it"
RELEASES = "hold a key to drive: it ends with the key's release"


class Pilot:
    """Keys in, requests and commands out. A request that fails is a note on the screen; a service that has gone is
    raised as NoService."""

    def __init__(self, robot: Robot, source: str, speed_mps: float, turn_radps: float) -> None:
        """The speeds are those at 100 %."""
        self.robot = robot
        self.source = source
        self.percent = FIRST_PERCENT
        self.hold = Hold()
        self.note: Span = ("motion is never enabled by itself: e enables it", PLAIN)
        """What to tell, and its role."""
        self.leaving = False
        self.joint = 0
        """The chosen joint of the arm, by its place in the settings."""
        self._full = (speed_mps, speed_mps, turn_radps)
        self._command: Velocity = (0.0, 0.0, 0.0)
        self._commanded_s = 0.0
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
        """Act on key events, and on what is due without any. `late`: they may have waited somewhere; then only what
        stops counts."""
        others = (row.who for row in state.sources if row.source == self.source and row.who != self._who)
        self._rival = next(others, "")
        if ("space", PRESS) in keys:
            self.hold.let_go()
            with self._noted():
                self.robot.estop("space key")
                self.note = LATCHED
            late = True  # what was typed before it, or with it, must not undo it
        if late:
            self._send(self.hold.let_go(), now_s)
            keys = [key for key in keys if key[0] in URGENT]
        moving = []
        for name, kind in keys:
            if name in AXES or name == FOCUS_OUT:
                moving.append((name, kind))
            elif not (state.arm and self._turn(name, kind, state.arm)) and kind != RELEASE and name != "space":
                self._press(name, state, now_s)
        if moving:
            self._drive(moving, state, now_s)
        # Nothing drives on that something else has stopped.
        if not state.enabled:
            self.hold.let_go()
        if state.estop != self._latched:
            self._latched = state.estop
            self.note = LATCHED if state.estop else self.note
        self._send(self.hold.due(now_s), now_s)

    @contextmanager
    def _noted(self) -> Iterator[None]:
        try:
            yield
        except NoService:
            raise
        except FailstopError as error:
            self.note = (str(error), FAIL)

    def _press(self, name: str, state: State, now_s: float) -> None:
        """A key that is none of motion; one that means nothing lets go of those that are."""
        if name == EVENTS:
            self.hold.releases = True
        elif name in STEPS_PERCENT:
            self.percent = max(10, min(100, self.percent + STEPS_PERCENT[name]))
        elif name in SIGNALS:
            os.kill(os.getpid(), SIGNALS[name])
        else:
            self._send(self.hold.let_go(), now_s)
            self.leaving = self.leaving or name in LEAVE
            with self._noted():
                if name == "r":
                    self.note = (self.robot.reset(), WARN)
                elif name == "e" and not state.arm:
                    self.note = (self.robot.enable(), OK)
                elif name == "e" and not (self._enabling and self._enabling.is_alive()):
                    self._enabling = threading.Thread(target=self._enable, daemon=True)
                    self._enabling.start()

    def _enable(self) -> None:
        """Beside the keys, since with an arm it takes seconds: the space key must stop meanwhile."""

        def tell(text: str) -> None:
            self.note = (text, PLAIN)

        try:
            self.note = (self.robot.enable(tell), OK)
        except FailstopError as error:
            self.note = (str(error), FAIL)

    def _turn(self, name: str, kind: int, seen: ArmState) -> bool:
        """True when the key is one of the arm's: acted on."""
        joints = list(seen.joints)
        digits = [str(number) for number in range(1, len(joints) + 1)]
        if name in digits:
            self.joint = digits.index(name)
            self.note = (f"joint {joints[self.joint]}: [ and ] turn it", PLAIN)
            return True
        if name not in TURNS:
            return False
        joint = joints[min(self.joint, len(joints) - 1)]
        with self._noted():
            arm = self.robot.arm
            if kind == RELEASE:
                arm.hold()
                return True
            arm.jog({joint: TURNS[name] * arm.joints[joint].speed / PULSES_PER_RAD * self.percent / 100})
            against = arm.state.closed or arm.state.refused
            self.note = (against or f"joint {joint}", WARN if against else PLAIN)
        return True

    def _drive(self, keys: list[Key], state: State, now_s: float) -> None:
        """The keys of motion. A press that could not move the wheels is a note, and so is one that would stop
        everything: a second publisher of a source is a reason to latch."""
        if any(kind != RELEASE and name in AXES for name, kind in keys):
            if against := self._against(state):
                self.note = against
                self.hold.let_go()
                return
            if self.note[1] in (WARN, FAIL) and state.blocked in (None, blocks.NO_COMMAND):
                self.note = ("", PLAIN)
        self._send(self.hold.events(keys, now_s), now_s)

    def _against(self, state: State) -> Span | None:
        """What keeps a press from moving the wheels."""
        if state.estop:
            return LATCHED
        if not state.enabled:
            return "motion is disabled: e enables it", WARN
        rival = f"{self._rival} drives as {self.source}: end it, or use --source with another one"
        return (rival, WARN) if self._rival else None

    def _send(self, wanted: Velocity | None, now_s: float) -> None:
        """Not even a zero goes out beside another publisher of the source: that would latch a stop."""
        if wanted is None or self._rival:
            return
        x, y, turn = (part * full * self.percent / 100 for part, full in zip(wanted, self._full, strict=True))
        self._command, self._commanded_s = (x, y, turn), now_s
        self.robot.drive(x, y, turn, manual=True, source=self.source)

    def lines(self, state: State, now_s: float, columns: int, *, fancy: bool) -> list[Line]:
        """The screen. `fancy`: it takes arrows."""
        command, (speed_mps, turn_radps) = self.command(now_s), self.speeds()
        keys = list(KEYS)
        if state.arm:
            digits = f"1 - {len(state.arm.joints)}"
            keys.append(("[ ]", "", "turn the chosen joint", digits, "choose a joint of the arm"))
        head: list[Line] = [[("failstop teleop", STRONG), (f"  {state.name}, as {self.source}", DIM)], []]
        for letters, arrows, moves, other, does in keys:
            left = [(f"{letters}  {arrows if fancy else '':<5}", STRONG), (f"{moves:<22}", PLAIN)]
            head.append([*left, (f"{other:<7}", STRONG), (does, FAIL if other == "space" else PLAIN)])
        body = [
            row("keys", *(("held", OK) if self.hold.active else ("none held", PLAIN))),
            row("speed", f"{self.percent} %: {speed_mps:.2f} m/s, {turn_radps:.2f} rad/s"),
            row("command", "none" if command is None else words.velocity(*command) or "zero"),
            summary.headline(state),
            *(self._arm(state.arm) if state.arm else []),
            summary.battery(state),
            summary.device(state),
        ]
        foot: list[Line] = [[], [self.note], [(RELEASES if self.hold.releases else REPEATS, DIM)]]
        above, below = (summary.wrapped(rows, columns, 0) for rows in ([*head, []], foot))
        return [*above, *summary.wrapped(body, columns), *below]

    def _arm(self, arm: ArmState) -> list[Line]:
        """What the arm does, and the chosen joint: where it is, or was sent."""
        joints = list(arm.joints.items())
        name, joint = joints[min(self.joint, len(joints) - 1)]
        where = "not read yet" if joint.at_rad is None else f"{joint.at_rad:+.2f} rad, {joint.at_by}"
        closed = f"; {arm.closed}" if arm.closed else ""
        return [row("arm", f"{summary.arm_headline(arm)}{closed}"), row("joint", f"{self.joint + 1} {name}: {where}")]

"""`failstop teleop`: drive with the keyboard, as long as keys are held."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterator

from failstop.api import words
from failstop.api.client import Run
from failstop.api.errors import FailstopError, NoService
from failstop.api.robot import Robot
from failstop.api.snapshot import ArmState, State
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.cli.screen.keys import (
    ASK,
    AXES,
    COMMAND_S,
    EVENTS,
    FOCUS_OUT,
    PRESS,
    RELEASE,
    UNASK,
    Decoder,
    Hold,
    Key,
    Velocity,
)
from failstop.cli.screen.summary import row
from failstop.cli.screen.terminal import Terminal
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN, Line, Span
from failstop.policy.settings import BY_KEY
from failstop.procs.gate.arm.joints import PULSES_PER_RAD
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE
from failstop.shm import blocks

EXAMPLES = """\
failstop teleop                         # e enables, space stops, q leaves
failstop teleop --speed 0.1 --turn 0.5  # slower at most
failstop teleop --source teleop         # as one of the settings' [sources]
ssh -t robot failstop teleop            # from elsewhere
"""

SPEED_MPS = float(BY_KEY["limits.vx_mps"].default)
TURN_RADPS = float(BY_KEY["limits.wz_radps"].default)
TURN_S = 0.05
LATE_S = 0.25
"""After a turn that took this long - the program was stopped, the terminal or the machine was held up - what was typed
meanwhile is old."""
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


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop teleop`."""
    add = parser.add_argument
    add("--speed", type=_positive, default=SPEED_MPS, metavar="M/S", help=f"at 100 %% (default: {SPEED_MPS:g})")
    add("--turn", type=_positive, default=TURN_RADPS, metavar="RAD/S", help=f"at 100 %% (default: {TURN_RADPS:g})")
    add("--source", default=DEFAULT_SOURCE, help=f"command as this source (default: {DEFAULT_SOURCE})")
    add_name(parser)


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value <= 10.0:
        raise ArgumentTypeError(f"{text}: allowed is more than 0, to 10")
    return value


def main(arguments: Namespace) -> int:
    """Drive; motion is disabled at the end. The exit code is 0 after q, else 128 and the signal's number."""
    Run(arguments.name).check("source", arguments.source)
    terminal = Terminal(on=ASK, off=UNASK)
    with Robot(arguments.name, client=CLIENT) as robot:
        robot.hold()  # takes the client slot: what is wrong with that, too, is to be said before the screen changes
        pilot = Pilot(robot, arguments.source, arguments.speed, arguments.turn)
        try:
            with terminal:
                _drive(terminal, pilot)
        finally:
            said = _disable(robot)
    with contextlib.suppress(OSError):  # the terminal may have gone
        print(said, file=sys.stderr if terminal.ended else sys.stdout)
    return 128 + terminal.ended if terminal.ended else 0


def _drive(terminal: Terminal, pilot: Pilot) -> None:
    decoder, name = Decoder(), pilot.robot.name
    turned_s, held_up = time.monotonic(), False
    for typed, due_s in terminal.turns(TURN_S):
        keys = decoder.feed(typed)
        try:
            state = pilot.robot.state
        except NoService:
            raise NoService(f"no service named {name!r} is running: begin again") from None
        if terminal.stopped:
            _pause(terminal, pilot)
            turned_s = 0.0  # what was typed meanwhile is late
            continue
        now_s = time.monotonic()
        late = now_s - turned_s > LATE_S
        # Where in a turn it was held up is not known: what is read next may have been typed meanwhile too. Ctrl-Z
        # leaves nothing that was typed.
        before, held_up, turned_s = held_up, late and turned_s > 0.0, now_s
        pilot.keys(keys, state, now_s, late=late or before)
        if pilot.leaving:
            return
        if due_s is not None:
            terminal.draw(pilot.lines(state, now_s, terminal.columns))


def _pause(terminal: Terminal, pilot: Pilot) -> None:
    """Ctrl-Z: the robot stands while nobody is at the keys."""
    _disable(pilot.robot)
    pilot.hold.let_go()
    terminal.suspend()
    pilot.note = ("motion was disabled while this was stopped: e enables it", WARN)


def _disable(robot: Robot) -> str:
    """Stop and disable; what came of it, in words. A service that can't be told stops by the command timeout."""
    try:
        return robot.disable()
    except FailstopError as error:
        return f"motion could not be disabled ({error}); the command timeout stops the wheels"


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
        if not state.enabled:
            self._send(self.hold.let_go(), now_s)  # nothing drives on that something else has stopped
        moving = []
        for name, kind in keys:
            if name in AXES or name == FOCUS_OUT:
                moving.append((name, kind))
            elif not (state.arm and self._turn(name, kind, state.arm)) and kind != RELEASE and name != "space":
                self._press(name, state, now_s)
        if any(name in AXES and kind != RELEASE for name, kind in moving):
            if against := self._against(state):
                self.note, moving = against, []
                self.hold.let_go()
            elif self.note[1] in (WARN, FAIL) and state.blocked in (None, blocks.NO_COMMAND):
                self.note = ("", PLAIN)
        self._send(self.hold.events(moving, now_s), now_s)
        if state.estop != self._latched:
            self._latched = state.estop
            self.note = LATCHED if state.estop else self.note

    @contextlib.contextmanager
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

    def _against(self, state: State) -> Span | None:
        """Why a press can't move the wheels, or would stop everything: a second publisher of a source is a reason to
        latch."""
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

    def lines(self, state: State, now_s: float, columns: int) -> list[Line]:
        """The screen."""
        speed_mps, _, turn_radps = (full * self.percent / 100 for full in self._full)
        command = self._command if now_s - self._commanded_s <= COMMAND_S else None
        keys = list(KEYS)
        if state.arm:
            digits = f"1 - {len(state.arm.joints)}"
            keys.append(("[ ]", "", "turn the chosen joint", digits, "choose a joint of the arm"))
        head: list[Line] = [[("failstop teleop", STRONG), (f"  {state.name}, as {self.source}", DIM)], []]
        for letters, arrows, moves, other, does in keys:
            left = [(f"{letters}  {arrows:<5}", STRONG), (f"{moves:<22}", PLAIN)]
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
        where = "not read yet" if joint.at_rad is None else f"{joint.at_rad:+.2f} rad"
        closed = f"; {arm.closed}" if arm.closed else ""
        return [row("arm", f"{summary.arm_headline(arm)}{closed}"), row("joint", f"{self.joint + 1} {name}: {where}")]

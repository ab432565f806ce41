"""`failstop teleop`: drives the robot with the keyboard, as long as you hold a key."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator

from failstop.api import verdict, words
from failstop.api.client import SeenRun
from failstop.api.errors import FailstopError, NoService, Refused
from failstop.api.robot import Robot
from failstop.api.snapshot import ArmState, State
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.cli.screen.keys import AXES, COMMAND_S, CTRL_D, SPACE, Hold, KeyDecoder, Velocity
from failstop.cli.screen.summary import row
from failstop.cli.screen.terminal import Terminal
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN, Line, Span
from failstop.messages import box
from failstop.messages.layout import GATE
from failstop.policy import kinematics
from failstop.policy.settings import FIRST_SOURCE

EXAMPLES = """\
failstop teleop                         # e enables, space stops, q leaves
failstop teleop --source teleop         # as [sources.teleop] of the settings
ssh -t robot failstop teleop            # from another computer
"""

LIMITS = ("limits.vx_mps", "limits.vy_mps", "limits.wz_radps")
"""The settings with the highest speeds forward, sideways and turning. Their values are the speeds at 100 %."""
TURN_S = 0.05
LATE_S = 0.25
"""If one pass of the loop takes longer than this, in seconds, the computer or the program was held up. Then the keys
that were typed during that pass are too old to move the robot."""
CLIENT = "failstop teleop"
FIRST_PERCENT = 50
STEPS_PERCENT = {"+": 10, "=": 10, "-": -10, "_": -10}
LEAVE = ("q", CTRL_D)
MOVERS = ("r", "e")
"""The keys that may let a stopped robot move again. They do nothing if other keys come in the same read, because a
terminal without marks around pasted text delivers a whole word at once."""
TURNS = {"[": -1, "]": 1}
"""The keys that turn the chosen joint of the arm while they are held, each with its direction. A digit chooses the
joint."""
KEYS = """\
w s  \u2191 \u2193    forward, backward     space  STOP, latched
a d  \u2190 \u2192    turn left, right      e      enable motion
{slide:<34}r      reset a latched stop
+ -         faster, slower        q      leave: stop; disable what e enabled
"""
SLIDE = "j l         slide left, right"
JOINTS = "[ ]         turn the chosen joint {digits:<7}choose a joint of the arm"
JERKS = (
    "the wheels stop after the first press because this keyboard repeats late; on the computer of the keyboard: "
    "`xset r rate 200 30` (X11), `sudo kbdrate -d 250 -r 30` (text console), else its keyboard settings"
)
HOW = "hold a key to drive; a tap drives for 0.3 s"


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop teleop`."""
    parser.add_argument(
        "--source",
        default=FIRST_SOURCE,
        help=f"drive as this source, one of [sources] in the settings (default: {FIRST_SOURCE})",
    )
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. At the end it stops the wheels, and disables motion if it has enabled motion itself. Returns 0
    after q, and 128 plus the signal's number after a signal."""
    SeenRun(arguments.name).check("source", arguments.source)
    terminal = Terminal(mouse=True)
    with Robot(arguments.name, client=CLIENT, disable_on_exit=False) as robot:
        robot.assert_interlocks()  # takes the client slot before the screen changes, so that an error can be read
        vx_mps, vy_mps, wz_radps = (float(robot.settings[key]) for key in LIMITS)
        slides = kinematics.AXES[str(robot.settings["wheels.layout"])][1]
        pilot = Pilot(robot, arguments.source, (vx_mps, vy_mps * slides, wz_radps))
        try:
            with terminal:
                _drive(terminal, pilot)
        finally:
            said = pilot.leave()
    with contextlib.suppress(OSError):  # the terminal may be closed
        print(said, file=sys.stderr if terminal.ended else sys.stdout)
    return 128 + terminal.ended if terminal.ended else 0


def _drive(terminal: Terminal, pilot: Pilot) -> None:
    decoder = KeyDecoder()
    turned_s, held_up = time.monotonic(), False
    for typed, due_s in terminal.turns(TURN_S):
        keys, state = decoder.feed(typed), pilot.robot.state
        now_s = time.monotonic()
        late = now_s - turned_s > LATE_S
        # The keys that are read next may be old too, because it is not known when in the pass the delay was.
        pilot.keys(keys, state, now_s, late=late or held_up)
        held_up, turned_s = late, now_s
        if pilot.leaving:
            return
        if due_s is not None:
            terminal.draw(pilot.lines(state, now_s, terminal.columns))


class Pilot:
    """Turns keys into requests and commands. If a request fails, a note on the screen says so. Raises NoService."""

    def __init__(self, robot: Robot, source: str, full: Velocity) -> None:
        """`source`: the source to command as. `full`: the velocity at 100 %, in m/s forward, m/s left (0 if the base
        can't move sideways), and rad/s counter-clockwise."""
        self.robot = robot
        self.source = source
        self.percent = FIRST_PERCENT
        self.hold = Hold()
        self.note: Span = ("", PLAIN)
        """The note about the last key, and the note's colour role. The note is shown until the state changes."""
        self.enabled = False
        """True if this program has enabled motion, or may have done so."""
        self.leaving = False
        self.joint = 0
        """The index of the chosen joint of the arm, in the order of the settings."""
        self._full = full
        self._command: Velocity = (0.0, 0.0, 0.0)
        self._commanded_s = 0.0
        self.enabling: threading.Thread | None = None
        self._seen: object = None
        """The parts of the state that notes depend on, as they were at the previous call of keys()."""
        self._told: Span = self.note
        """The note at the beginning of the previous call of keys()."""
        self._asked = False
        """True if a thread was enabling motion at the previous call of keys(). With an arm, enabling takes seconds,
        because the arm first moves to its drive pose."""
        self._rival = ""
        """Another program that commands as the same source; empty if there is none."""
        self._who = f"{CLIENT} (pid {os.getpid()})"

    def keys(self, keys: list[str], state: State, now_s: float, *, late: bool) -> None:
        """Act on the keys that were typed. Call this even if no key was typed, because the robot must stop when a key
        is no longer held. `late`: True if the keys may be old. Old keys may only stop the robot or end the program."""
        self._drop_old_note(state)
        others = (row.who for row in state.sources if row.source == self.source and row.who != self._who)
        self._rival = next(others, "")
        if SPACE in keys:
            self.hold.let_go()
            with self._noted():
                self.robot.estop("space key")
            late = True  # a key that was typed before the space key, or together with it, must not undo the stop
        if len(typed := set(keys)) > 1 and typed & {*MOVERS}:
            late, self.note = True, ("several keys came at once, as in pasted text: press one after the other", WARN)
        if late:
            keys = [key for key in keys if key in LEAVE]
        if late or not state.enabled:
            self._send(self.hold.let_go(), now_s)  # a key that is still held must not drive after a stop
        moving = []
        for key in keys:
            if key in AXES:
                moving.append(key)
            elif not (state.arm and self._turn(key, state.arm)):
                self._press(key, state, now_s)
        if moving:
            if against := self._against(state):
                self.note, moving = against, []
                self.hold.let_go()
            elif self.note[1] in (WARN, FAIL) and state.blocked in (None, box.NO_COMMAND, box.HELD):
                self.note = ("", PLAIN)
        self._send(self.hold.pressed(moving, now_s), now_s)

    def _drop_old_note(self, state: State) -> None:
        """Drop the note if the state has changed since the last call, unless the note is newer than that call. If
        motion was disabled, also forget that this program has enabled motion. Otherwise this program might later
        disable motion that somebody else has enabled."""
        seen = (state.enabled, state.estop, state.waiting_for, state.device.state)
        if seen != self._seen and self.note is self._told:
            self.note = ("", PLAIN)
        self.enabled &= state.enabled or self._asked
        self._seen, self._told, self._asked = seen, self.note, self._asking()

    def _asking(self) -> bool:
        """Return True while another thread is enabling motion."""
        return bool(self.enabling and self.enabling.is_alive())

    def leave(self) -> str:
        """Stop the wheels, and disable motion if this program has enabled it. Returns a text that says what was done.
        If the service can't be reached, its command timeout stops the wheels."""
        try:
            if self.enabled or self._asking():
                return self.robot.disable()
            if not self._rival:
                self._send(self.hold.let_go(), 0.0)
            return "motion stays enabled, as it was before" if self.robot.state.enabled else "motion is disabled"
        except FailstopError as error:
            return f"the service can't be told ({error}); the command timeout stops the wheels"

    @contextlib.contextmanager
    def _noted(self) -> Iterator[None]:
        try:
            yield
        except NoService:
            raise
        except FailstopError as error:
            # Only the reason of a refusal, because the keys that help are shown below it.
            self.note = (f"refused: {error.reason}" if isinstance(error, Refused) else str(error), FAIL)

    def _press(self, key: str, state: State, now_s: float) -> None:
        """Act on a key that does not move the robot. A key for the speed changes only the speed. Any other key, even an
        unknown one, also stops the motion, as if the held motion key was released."""
        if key in STEPS_PERCENT:
            self.percent = max(10, min(100, self.percent + STEPS_PERCENT[key]))
        else:
            self._send(self.hold.let_go(), now_s)
            self.leaving = self.leaving or key in LEAVE
            with self._noted():
                if key == "r":
                    self.note = (self.robot.reset(), WARN)
                elif key == "e" and state.enabled:
                    self.note = ("motion is enabled already", PLAIN)
                elif key == "e" and not state.arm:
                    self._enable()
                elif key == "e" and not self._asking():
                    self.enabling = threading.Thread(target=self._enable_beside, daemon=True)
                    self.enabling.start()
                    self._asked = True

    def _enable(self) -> None:
        """Enable motion, and remember to disable it when this program ends. It is remembered before the service
        answers, because the answer may get lost."""

        def show(text: str) -> None:
            self.note = (text, PLAIN)

        self.enabled = True
        try:
            self.note = (self.robot.enable(show), OK)
        except Refused:
            self.enabled = False
            raise

    def _enable_beside(self) -> None:
        """Enable motion in another thread. With an arm this takes seconds, and the space key must stop the robot
        meanwhile."""
        with contextlib.suppress(NoService), self._noted():  # the next read of the state shows NoService too
            self._enable()

    def _turn(self, key: str, seen: ArmState) -> bool:
        """Act on a key for the arm. Returns False if the key is not one of the arm's keys."""
        joints = list(seen.joints)
        digits = [str(number) for number in range(1, len(joints) + 1)]
        if key in digits:
            self.joint = digits.index(key)
            self.note = (f"joint {joints[self.joint]}: [ and ] turn it", PLAIN)
            return True
        if key not in TURNS:
            return False
        joint = joints[min(self.joint, len(joints) - 1)]
        with self._noted():
            arm = self.robot.arm
            arm.jog({joint: TURNS[key] * arm.joints[joint].speed_radps * self.percent / 100})
            against = arm.state.closed or arm.state.refused
            self.note = (against or f"joint {joint}", WARN if against else PLAIN)
        return True

    def _against(self, state: State) -> Span | None:
        """Return the reason why a motion key must do nothing, or None if the key may drive. Either the wheels are
        stopped, or another program commands as the same source. In the second case a command would latch a stop."""
        if holds := self.holds(state):
            return holds
        rival = f"{self._rival} drives as {self.source}: end it, or use --source with another one"
        return (rival, WARN) if self._rival else None

    def holds(self, state: State) -> Span | None:
        """Return the reason why the wheels are stopped, with the keys that help. None if the keys can drive the
        robot."""
        if any(process.state == "dead" for process in state.processes.values()):
            return "the service has died: if a wheel turns, use the POWER SWITCH; q leaves", FAIL
        first = f"wait for {GATE}, then " if GATE in verdict.down(state) else ""
        if not first and state.waiting_for and not verdict.down(state):
            first = f"wait for {state.waiting_for}, then "
        if state.device.state != "open":
            first = "plug the board in, then "
        if state.estop:
            return f"a stop is latched: {first}r resets it, then e enables motion", FAIL
        return None if state.enabled else (f"motion is disabled: {first}e enables it", WARN)

    def _send(self, wanted: Velocity | None, now_s: float) -> None:
        """Send a command, unless another program commands as the same source. A second publisher of a source latches a
        stop, even with a command of zero."""
        if wanted is None or self._rival:
            return
        x, y, turn = (part * full * self.percent / 100 for part, full in zip(wanted, self._full, strict=True))
        self._command, self._commanded_s = (x, y, turn), now_s
        self.robot.drive(x, y, turn, manual=True, source=self.source)

    def lines(self, state: State, now_s: float, columns: int) -> list[Line]:
        """Return the lines of the screen."""
        speed_mps, _, turn_radps = (full * self.percent / 100 for full in self._full)
        command = self._command if now_s - self._commanded_s <= COMMAND_S else None
        keys = KEYS.format(slide=SLIDE if self._full[1] else "").splitlines()
        if state.arm:
            keys.append(JOINTS.format(digits=f"1 - {len(state.arm.joints)}"))
        rows: list[Line] = [
            [(f"failstop teleop{words.of(state.name)}", STRONG), (f"  as {self.source}", DIM)],
            [],
            *([(text, PLAIN)] for text in keys),
            [],
            row("keys", *(("held", OK) if self.hold.active else ("none held", PLAIN))),
            row("speed", f"{self.percent} %: {speed_mps:.2f} m/s, {turn_radps:.2f} rad/s"),
            row("command", "none" if command is None else words.velocity(*command) or "zero"),
            summary.headline(state),
            summary.observed(state),
            *(self._arm(state.arm) if state.arm else []),
            summary.battery(state),
            summary.device(state),
            [],
            [self.note if self.note[0] else self.holds(state) or ("", PLAIN)],
            [(JERKS if self.hold.jerks else HOW, DIM)],
        ]
        return summary.wrapped(rows, columns)

    def _arm(self, arm: ArmState) -> list[Line]:
        """Return the lines about the arm and the chosen joint. The joint's line shows the commanded angle, or the
        measured angle if none was commanded."""
        joints = list(arm.joints.items())
        name, joint = joints[min(self.joint, len(joints) - 1)]
        where = "not read yet" if joint.at_rad is None else f"{joint.at_rad:+.2f} rad"
        closed = f"; {arm.closed}" if arm.closed else ""
        return [row("arm", f"{summary.arm_headline(arm)}{closed}"), row("joint", f"{self.joint + 1} {name}: {where}")]

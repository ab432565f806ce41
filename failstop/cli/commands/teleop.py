"""`failstop teleop`: drive with the keyboard, as long as keys are held."""

from __future__ import annotations

import contextlib
import sys
import time

from failstop.api.errors import FailstopError, NoService
from failstop.api.robot import Robot
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import cockpit, keys
from failstop.cli.screen.follow import Follower
from failstop.cli.screen.live import fit
from failstop.cli.screen.pilot import CLIENT, Pilot
from failstop.cli.screen.terminal import Terminal
from failstop.policy.settings import BY_KEY
from failstop.procs.gate.sources import DEFAULT as DEFAULT_SOURCE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from failstop.api.state import State

EXAMPLES = """\
failstop teleop                         # e enables, space stops, q leaves
failstop teleop --speed 0.1 --turn 0.5  # slower at most
failstop teleop --source teleop         # as one of the settings' [sources]
ssh -t robot failstop teleop            # from elsewhere
"""

SPEED_MPS = float(BY_KEY["limits.vx_mps"].default)
TURN_RADPS = float(BY_KEY["limits.wz_radps"].default)
DRAW_S = 0.1
TURN_S = 0.05
LATE_S = 0.25
"""After a turn that took this long - the program was stopped, the terminal or the machine was held up - what was typed
meanwhile is old."""


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
        from argparse import ArgumentTypeError

        raise ArgumentTypeError(f"{text}: allowed is more than 0, to 10")
    return value


def main(arguments: Namespace) -> int:
    """Drive; motion is disabled at the end. The exit code is 0 after q, else 128 and the signal's number."""
    follower = Follower(arguments.name)
    if follower.reader:
        follower.reader.check("source", arguments.source)
    terminal = Terminal(on=keys.ASK, off=keys.UNASK)
    with Robot(arguments.name, client=CLIENT) as robot:
        robot.hold()  # takes the client slot: what is wrong with that, too, is to be said before the screen changes
        pilot = Pilot(robot, arguments.source, arguments.speed, arguments.turn)
        try:
            with terminal:
                _drive(terminal, follower, pilot)
        finally:
            said = _disable(robot)
    with contextlib.suppress(OSError):  # the terminal may have gone
        print(said, file=sys.stderr if terminal.ended else sys.stdout)
    return 128 + terminal.ended if terminal.ended else 0


def _drive(terminal: Terminal, follower: Follower, pilot: Pilot) -> None:
    decoder = keys.Decoder()
    run = follower.reader
    drawn_s = 0.0
    turned_s, held_up = time.monotonic(), False
    while not (terminal.ended or pilot.leaving):
        typed = decoder.feed(terminal.wait(TURN_S))
        state = follower.read(time.monotonic())
        if follower.reader is not run:
            raise NoService(follower.note or f"the service {pilot.robot.name!r} was restarted: begin again")
        if state is None:
            raise FailstopError(follower.note)
        if terminal.stopped:
            _pause(terminal, pilot)
            turned_s = drawn_s = 0.0  # what was typed meanwhile is late
            continue
        now_s = time.monotonic()
        late = now_s - turned_s > LATE_S
        # Where in a turn it was held up is not known: what is read next may have been typed meanwhile too. Ctrl-Z
        # leaves nothing that was typed.
        before, held_up, turned_s = held_up, late and turned_s > 0.0, now_s
        pilot.keys(typed, state, now_s, late=late or before)
        if now_s - drawn_s >= DRAW_S:
            drawn_s = now_s
            _draw(terminal, pilot, state, now_s)


def _draw(terminal: Terminal, pilot: Pilot, state: State, now_s: float) -> None:
    rows = cockpit.lines(
        state,
        held=pilot.hold.active,
        releases=pilot.hold.releases,
        command=pilot.command(now_s),
        percent=pilot.percent,
        speeds=pilot.speeds(),
        note=pilot.note,
        source=pilot.source,
        fancy=style.fancy(),
        columns=terminal.columns,
        joint=pilot.joint,
    )
    terminal.draw(fit(rows, terminal.rows))


def _pause(terminal: Terminal, pilot: Pilot) -> None:
    """Ctrl-Z: the robot stands while nobody is at the keys, and its slot is free for others."""
    _disable(pilot.robot)
    pilot.hold.let_go()
    pilot.robot.release()
    terminal.suspend()
    pilot.note = ("motion was disabled while this was stopped: e enables it", style.WARN)


def _disable(robot: Robot) -> str:
    """Stop and disable; what came of it, in words. A service that can't be told stops by the command timeout."""
    try:
        return robot.disable()
    except FailstopError as error:
        return f"motion could not be disabled ({error}); the command timeout stops the wheels"

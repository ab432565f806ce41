"""`failstop drive`: a velocity for a while, then zero. A person types it, so it is a manual command."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace

from failstop.api.errors import Refused
from failstop.api.robot import Robot
from failstop.api.verdict import next_step
from failstop.api.words import velocity
from failstop.cli.commands import add_name
from failstop.supervisor.fold import fitted

EXAMPLES = """\
failstop drive 0.1 0 0             # 0.1 m/s forward for 1 s
failstop drive 0 0.1 0 --for 2     # to the left
failstop drive 0.1 0 -0.5 --for 3  # forward, turning right
"""

REPEAT_S = 0.05
RESTARTED_S = 1.0
POLL_S = 0.01


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop drive`."""
    parser.add_argument("vx", type=float, help="m/s forward")
    parser.add_argument("vy", type=float, help="m/s left")
    parser.add_argument("wz", type=float, help="rad/s counter-clockwise")
    parser.add_argument("--for", dest="seconds", type=float, default=1.0, metavar="S", help="how long (default: 1)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Drive; raises Refused as soon as something blocks the wheels."""
    with Robot(arguments.name, client="failstop drive") as robot:
        until_s = time.monotonic() + arguments.seconds
        if reason := _blocked(robot):
            raise Refused(reason)
        asked = (arguments.vx, arguments.vy, arguments.wz)
        if arguments.vy and robot.settings["wheels.layout"] == "differential":
            raise Refused(f"a differential base can't move sideways: {arguments.vy:g} m/s left is not for it; give 0")
        reached = asked
        while time.monotonic() < until_s:
            robot.drive(*asked, manual=True)
            time.sleep(min(REPEAT_S, max(0.0, until_s - time.monotonic())))
            if reason := _blocked(robot):
                raise Refused(_settled(robot) or reason)
            reached = robot.state.body_vel
    less = any(abs(got) < 0.98 * abs(wanted) for got, wanted in zip(reached, asked, strict=True))
    held = f", no faster than {velocity(*reached) or 'zero'} (limits and ramp)" if less else ""
    print(fitted(f"drove for {arguments.seconds:g} s{held}; the wheels stop", 1, 2))
    return 0


def _settled(robot: Robot) -> str:
    """What blocks when the process that died is there again, which is quick: nobody needs to be told to wait for it."""
    until_s = time.monotonic() + RESTARTED_S
    while robot.state.waiting_for and time.monotonic() < until_s:
        time.sleep(POLL_S)
    return _blocked(robot)


def _blocked(robot: Robot) -> str:
    """Why driving is pointless, with the command that helps."""
    state = robot.state
    if state.estop:
        return f"a stop is latched ({state.cause}); next: {next_step(state)}"
    if not state.enabled:
        return f"motion is disabled; next: {next_step(state)}"
    return ""

"""`failstop enable`, `disable`, `reset`, `limit` and `drive`: each sends a request to the service and prints the
answer."""

from __future__ import annotations

import re
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable

from failstop.api import steps, verdict
from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Blocked, Driving, Preempted, Robot
from failstop.api.words import velocity
from failstop.cli import standard
from failstop.cli.commands import add_name, seconds
from failstop.cli.screen.progress import Progress
from failstop.messages.records import CAUSE
from failstop.policy.kinematics import AXES
from failstop.policy.settings import FIRST_SOURCE

EXAMPLES = {
    "enable": """\
failstop enable
failstop enable --name left  # ask the service named left
""",
    "disable": """\
failstop disable             # the wheels stop at once
failstop disable --name left
""",
    "reset": """\
failstop reset   # clears the stop and moves nothing
failstop enable  # only after you have looked at the robot
""",
    "limit": """\
failstop limit      # print the limit
failstop limit 30   # 30 % for all drivers, until you change it
failstop limit 100  # lift the limit
""",
    "drive": """\
failstop drive 0.1 0 0             # 0.1 m/s forward for 1 s
failstop drive 0 0.1 0 --for 2     # to the left
failstop drive 0.1 0 -0.5 --for 3  # forward, turning right
""",
}

NEGATIVE = re.compile(r"-\.?\d")
"""How a negative number begins, for the parser of the arguments."""
ALLOWED_PERCENT = "5 to 100"
REPEAT_S = 0.05
IS_LATCHED = f"a stop is latched ({CAUSE})"
RESTARTED_S = 0.5
"""How long to wait before finding out why the wheels are blocked, in seconds. If a process has died, it has normally
been restarted by then, so the message need not tell the user to wait for the restart."""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of one command, for example `drive`. The name of the parser ends with the command's name."""
    add, command = parser.add_argument, parser.prog.rpartition(" ")[2]
    parser._negative_number_matcher = NEGATIVE  # older Pythons take -1e-1 for an option
    if command == "limit":
        add(
            "percent",
            nargs="?",
            type=float,
            metavar="PERCENT",
            help=f"the new limit, {ALLOWED_PERCENT} percent (without it, the command prints the limit)",
        )
    if command == "drive":
        add("vx", type=float, help="speed forward, m/s")
        add("vy", type=float, help="speed to the left, m/s")
        add("wz", type=float, help="turn rate counter-clockwise, rad/s")
        add("--for", dest="seconds", type=seconds, default=1.0, metavar="S", help="for how many seconds (default: 1)")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. Raises Refused if the service refuses the request."""
    command, progress = arguments.command, Progress()
    failed: FailstopError | None = None
    with Robot(arguments.name, client=f"failstop {command}", disable_on_exit=command == "drive") as robot:
        verbs: dict[str, Callable[[], str]] = {
            "enable": lambda: robot.enable(progress),
            "disable": robot.disable,
            "reset": robot.reset,
            "limit": lambda: _limit(robot, arguments.percent),
            "drive": lambda: _drive(robot, (arguments.vx, arguments.vy, arguments.wz), arguments.seconds),
        }
        try:
            with progress:  # with an arm, enabling takes seconds
                said = verbs[command]()
            standard.print_line(said)
            if command == "enable" and (state := robot.state):
                if why := verdict.unproven(state):
                    see_to = "next: check the board's power and its cable, then `failstop doctor`"
                    standard.say(f"unproven: {why}, so no stop is known to reach the wheels; {see_to}")
                if doubt := verdict.doubt(state):
                    standard.say(f"{doubt}; next: {steps.line(state)}")
        except ValueError as error:  # a value is out of range or not finite
            failed = FailstopError(str(error))
        except FailstopError as error:
            failed = error
    # Raised only here: an error that leaves the `with` block counts as the death of a driver. So after a refused
    # `drive`, the gate would disable motion, also for another program that drives.
    if failed:
        raise failed
    return 0


def _limit(robot: Robot, percent: float | None) -> str:
    """Set the speed limit, and return a text about it. If `percent` is None, only describe the present limit. Raises
    Refused if the limit is not allowed."""
    if percent is None:
        now = robot.state.speed_limit
        return f"speed limited to {100 * now:.0f} % of the settings'" if now < 1 else "no speed limit is set (100 %)"
    if not 0 < percent <= 100:
        raise Refused(f"a speed limit of {percent:g} %: must be {ALLOWED_PERCENT}")
    return robot.limit_speed(percent / 100)


def _drive(robot: Robot, asked: tuple[float, float, float], for_s: float) -> str:
    """Drive at the velocity `asked` for `for_s` seconds, and return a text about it. Afterwards the caller must stop
    the wheels. The commands count as manual, because a person has typed them. Raises Refused if the base can't move
    sideways as asked, if something blocks the wheels, if a source with a higher priority drives, or if the wheels got
    no command."""
    until_s = time.monotonic() + for_s
    if refused := _blocked(robot):
        raise refused
    if asked[1] and not AXES[str(robot.settings["wheels.layout"])][1]:
        raise Refused(f"this base can't move sideways, so vy must be 0 (not {asked[1]:g})")
    reached, driven = asked, False
    while time.monotonic() < until_s:
        answer = robot.drive(*asked, manual=True)
        driven = driven or isinstance(answer, Driving)
        if isinstance(answer, Preempted):
            raise Refused(f"{answer.by} drives as {answer.source}, which has priority over {FIRST_SOURCE}")
        time.sleep(min(REPEAT_S, max(0.0, until_s - time.monotonic())))
        if refused := _blocked(robot):
            time.sleep(RESTARTED_S)
            raise _blocked(robot) or refused
        reached = robot.state.body_vel
    if not driven:
        raise Refused(f"the wheels got no command: {answer.why}" if isinstance(answer, Blocked) else "the gate is busy")
    less = any(abs(got) < 0.98 * abs(wanted) for got, wanted in zip(reached, asked, strict=True))
    held = f", but only {velocity(*reached) or 'zero'} (limits and ramp)" if less else ""
    doubt = verdict.unproven(robot.state)
    what = f"unproven: {doubt}; commanded" if doubt else "drove"
    return f"{what} for {for_s:g} s{held}; now the wheels are told to stop"


def _blocked(robot: Robot) -> Refused | None:
    """Return the reason why the robot can't be driven at present, with the shell command that helps. None if it can be
    driven."""
    state = robot.state
    if state.cause:
        return Refused(IS_LATCHED, state.cause, steps.line(state))
    return None if state.enabled else Refused("motion is disabled", step=steps.line(state))

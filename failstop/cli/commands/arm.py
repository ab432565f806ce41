"""`failstop arm`: shows where the arm is, moves it, holds it, or switches its torque off."""

from __future__ import annotations

import dataclasses
import time
from argparse import ArgumentParser, Namespace

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.api.snapshot import ArmState
from failstop.api.words import span
from failstop.cli import standard, style
from failstop.cli.commands import add_name, seconds
from failstop.cli.commands.requests import REPEAT_S
from failstop.cli.screen import summary
from failstop.cli.screen.progress import Progress

EXAMPLES = """\
failstop arm                           # where each joint is, and any faults
failstop arm drive                     # slowly to the drive pose
failstop arm move base=0.5 wrist=-0.3  # rad, as fast as the settings allow
failstop arm move base=0 --over 3      # takes 3 s
failstop arm jog base=0.2 --for 1      # turn it at 0.2 rad/s for 1 s
failstop arm hold                      # stop where it is; the torque stays on
failstop arm release                   # torque off: the arm falls
"""

TORQUES = {True: "on", False: "off", None: "not read"}
VERBS = ("status", "move", "jog", "drive", "tuck", "hold", "release", "read")
WHAT = (
    "status (default): show where each joint is; move: go to the given angles; jog: turn joints at the given speeds; "
    "drive, tuck: go to the pose of that name; hold: stop where the arm is; release: switch off the torque, so the arm "
    "falls; read: ask the servos where they are, then show the status"
)
"""The help text for the verbs in VERBS."""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop arm`."""
    add = parser.add_argument
    add("verb", nargs="?", default="status", choices=VERBS, help=WHAT)
    add(
        "joints",
        nargs="*",
        metavar="JOINT=VALUE",
        help="with move: the angle of each joint, rad; with jog: its speed, rad/s",
    )
    add(
        "--over",
        type=seconds,
        default=0.0,
        metavar="S",
        help="with move: how many seconds the move takes (default: as few as the settings allow)",
    )
    add(
        "--for",
        dest="seconds",
        type=seconds,
        default=1.0,
        metavar="S",
        help="with jog: for how many seconds (default: 1)",
    )
    add("--json", action="store_true", help="with status: print JSON instead of text")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. Raises Refused if the service refuses the request."""
    verb = arguments.verb
    with Robot(arguments.name, client="failstop arm") as robot:
        arm, values, progress = robot.arm, _values(arguments.joints), Progress()
        if verb in ("move", "jog") and not values:
            raise FailstopError(f"failstop arm {verb}: which joint? One of {', '.join(arm.joints)}, as NAME=VALUE")
        verbs = {
            "move": lambda: arm.move(values, arguments.over, progress=progress),
            "jog": lambda: _jog(robot, values, arguments.seconds),
            "drive": lambda: arm.pose("drive", progress=progress),
            "tuck": lambda: arm.pose("tuck", progress=progress),
            "hold": arm.hold,
            "release": arm.release,
        }
        try:
            if verb in verbs:
                with progress:
                    said = verbs[verb]()
                standard.print_line(said)
                return 0
            if verb == "read":
                arm.read()
        except ValueError as error:
            raise FailstopError(str(error)) from None
        style.show(style.record(dataclasses.asdict(arm.state)) if arguments.json else _lines(arm.state))
    return 0


def _jog(robot: Robot, rates: dict[str, float], for_s: float) -> str:
    until_s = time.monotonic() + for_s
    while (left_s := until_s - time.monotonic()) > 0:
        robot.arm.jog(rates)
        time.sleep(min(REPEAT_S, left_s))
        if refused := robot.arm.state.refused:
            raise FailstopError(refused)
    return robot.arm.hold()


def _values(words: list[str]) -> dict[str, float]:
    found = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise FailstopError(f"{word!r}: write JOINT=VALUE, as in base=0.5") from None
    return found


def _lines(arm: ArmState) -> list[style.Line]:
    """Return the arm's state as lines for the terminal, with a table of its joints."""
    head = [("arm", summary.arm_headline(arm)), *([("closed", arm.closed)] if arm.closed else [])]
    head += [("wrong", text) for text in arm.wrong]
    head += [("refused", arm.refused)] if arm.refused else []
    rows = [("joint", " servo", " angle", " pulses", " commanded", " read", "torque")]
    for name, joint in arm.joints.items():
        angle = "-" if joint.angle_rad is None else f"{joint.angle_rad:+.3f}"
        measured = "-" if joint.pulses is None else f"{joint.pulses}"
        commanded = "-" if joint.commanded_rad is None else f"{joint.commanded_rad:+.3f}"
        age = "never" if joint.age_s is None else f"{span(joint.age_s)} ago"
        heat = f", {joint.temperature_c} C" if joint.temperature_c else ""
        torque = f"{TORQUES[joint.torque]}{heat}"
        rows.append((name, f" {joint.servo}", f" {angle}", f" {measured}", f" {commanded}", f" {age}", torque))
    table = style.table([[(cell, style.PLAIN) for cell in cells] for cells in rows])
    return [*(summary.row(label, text) for label, text in head), *table]

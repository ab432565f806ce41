"""`failstop limit`: how fast anybody may drive now, in percent of the settings' speeds."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from failstop.api.robot import Robot
from failstop.api.state import StateReader
from failstop.api.words import limited
from failstop.cli.commands import add_name

EXAMPLES = """\
failstop limit 30   # of every driver, until another is set
failstop limit 100  # lift it
failstop limit      # what it is now
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop limit`."""
    parser.add_argument("percent", nargs="?", type=float, metavar="PERCENT", help="5 to 100")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Set it, or show it."""
    if arguments.percent is None:
        share = StateReader(arguments.name).read().speed_limit
        print(limited(share) if share < 1 else "no speed limit but the settings'")
        return 0
    with Robot(arguments.name, client="failstop limit", disable_on_exit=False) as robot:
        print(robot.limit_speed(arguments.percent / 100))
    return 0

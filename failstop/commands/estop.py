"""`failstop estop`: a latched stop. Every local user may."""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace

from failstop.commands import add_name
from failstop.errors import NoAnswer
from failstop.fold import fitted
from failstop.robot import Robot
from failstop.screen.verdict import next_step
from failstop.shm.records import ASKED_BYTES

EXAMPLES = """\
failstop estop
failstop estop hand near wheel
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop estop`."""
    parser.add_argument("reason", nargs="*", help="why; shown by `failstop status` and in the journal")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Write to the stop pipe, then see that the service says so."""
    with Robot(arguments.name, client="failstop estop") as robot:
        epoch = robot.state.epoch
        robot.estop(" ".join(arguments.reason))
        if len(" ".join(arguments.reason).encode("utf-8", "replace")) > ASKED_BYTES:
            sys.stderr.write(f"failstop: the reason is cut to {ASKED_BYTES} bytes\n")
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            state = robot.state
            if state.epoch > epoch and state.estop:
                print(fitted(f"e-stop latched ({state.estop}); next: {next_step(state)}", 1, 2))
                return 0
            time.sleep(0.002)
    raise NoAnswer("the stop request is written, but nobody latched it within 1 s: use `failstop stop`, POWER SWITCH")

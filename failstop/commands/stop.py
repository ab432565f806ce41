"""`failstop stop`: the stop tool. Needs nothing running."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

from failstop.procs.stopper import tool
from failstop.supervisor.settings import BY_KEY


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop stop`."""
    default = str(BY_KEY["device.path"].default)
    parser.add_argument("--device", metavar="PATH", default=default, help=f"the board's port (default: {default})")
    parser.add_argument("--wait", metavar="S", type=float, default=30.0, help="how long to try (default: 30 s)")


def main(arguments: Namespace) -> int:
    """Write the stop burst; raises PortError when the port can't be had in time."""
    after_s = tool.stop(arguments.device, arguments.wait, lambda text: print(f"failstop: {text}", file=sys.stderr))
    print(f"stop frame sent (after {after_s:.1f} s)")
    return 0

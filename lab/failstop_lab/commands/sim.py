"""`failstop sim`: a simulated controller board, to try everything without a robot."""

from __future__ import annotations

import argparse

from failstop_lab.sim.options import add_arguments, from_arguments
from failstop_lab.sim.serve import serve

__all__ = ["add_arguments", "main"]


EXAMPLES = """\
failstop sim               # then: failstop run --device /tmp/board
failstop sim --verbose     # also prints what the wheels do
failstop sim --device /tmp/board --record board.jsonl --imu-hz 0
failstop sim --device /run/board --usb   # as root: a USB device
"""


def main(args: argparse.Namespace) -> int:
    """Run the board until SIGTERM or SIGINT; 0 after that, 1 with a message when it cannot be set up."""
    return serve(from_arguments(args))

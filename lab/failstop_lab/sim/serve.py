"""Running a simulated board in the foreground: says where it is, and with --verbose what it is told."""

from __future__ import annotations

import contextlib
import sys

from failstop.policy.layouts import BOARDS
from failstop_lab.sim.options import Options
from failstop_lab.sim.process import Simulator
from failstop_lab.sim.pty_port import SimError
from failstop_lab.sim.teller import Teller
from failstop_lab.sim.usb.port import VHCI


def serve(options: Options) -> int:
    """Run a board to its end. One line on standard output says that it is ready. Returns the exit code."""
    on_frame = Teller(_say).frame if options.verbose else None
    try:
        simulator = Simulator(options, on_frame=on_frame)
        _say(_where(options, simulator))
        simulator.run()
    except SimError as error:
        print(f"failstop sim: {error}", file=sys.stderr)
        return 1
    return 0


def _where(options: Options, simulator: Simulator) -> str:
    if not options.usb:
        run = f"failstop run --device {options.link}"
        needs = "" if options.board == BOARDS[0] else f' --config FILE, which says board.kind = "{options.board}"'
        return f"simulated board at {options.link} ({simulator.node}): {run}{needs}"
    if options.usb != VHCI:
        return f"simulated board on USB, for the machine at {options.usb}: its kernel names the port"
    return "simulated board on USB: failstop run --device /dev/ttyACM0, or as the kernel names it (failstop doctor)"


def _say(line: str) -> None:
    # Nobody may be reading: the board goes on.
    with contextlib.suppress(OSError):
        print(line, flush=True)

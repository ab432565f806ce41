"""Running a simulated board in the foreground: says where it is, and with --verbose what the wheels do."""

from __future__ import annotations

import contextlib
import sys

from failstop.board.sim.model import Frame, Speeds
from failstop.board.sim.options import Options
from failstop.board.sim.process import Simulator
from failstop.board.sim.pty_port import SimError


def serve(options: Options) -> int:
    """Run a board to its end. One line on standard output says that it is ready. Returns the exit code."""
    on_frame = _WheelPrinter().frame if options.verbose else None
    try:
        simulator = Simulator(options, on_frame=on_frame)
        _say(f"simulated board at {options.link} ({simulator.node}): failstop run --device {options.link}")
        simulator.run()
    except SimError as error:
        print(f"failstop sim: {error}", file=sys.stderr)
        return 1
    return 0


class _WheelPrinter:
    """Prints the wheel speeds whenever they change, with the seconds since the first change."""

    def __init__(self) -> None:
        self._speeds: Speeds = (0.0, 0.0, 0.0, 0.0)
        self._first_ns: int | None = None

    def frame(self, frame: Frame) -> None:
        if frame.speeds == self._speeds:
            return
        self._speeds = frame.speeds
        if self._first_ns is None:
            self._first_ns = frame.executed_ns
        wheels = "  ".join(f"{speed:+7.3f}" for speed in frame.speeds)
        state = "wheels turn" if any(frame.speeds) else "wheels stop"
        _say(f"{(frame.executed_ns - self._first_ns) / 1e9:9.3f} s  {state}  {wheels} rps")


def _say(line: str) -> None:
    # Nobody may be reading: the board goes on.
    with contextlib.suppress(OSError):
        print(line, flush=True)

"""A client that drives forever, inside a container: run as a user of the group failstop, told what to do by lines.

It commands a velocity every 20 ms, whatever happens to the service meanwhile. A line `enable` has it reset what is
latched and enable motion; it answers every line with one: `done`, or why not.
"""

from __future__ import annotations

import contextlib
import select
import sys
import time

sys.path.insert(0, __file__.rsplit("/", 2)[0])

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot

EVERY_S = 0.02
FORWARD_MPS = 0.2
RESET_S = 5.0
"""A reset is refused until the stop before it has been carried out."""


def main(name: str) -> int:
    """Drive until standard input is closed."""
    robot: Robot | None = None
    while True:
        if select.select((sys.stdin,), (), (), EVERY_S)[0]:
            told = sys.stdin.readline()
            if robot:
                # Of an earlier run, perhaps: its slot is nobody's any more.
                with contextlib.suppress(FailstopError, OSError):
                    robot.close()
                robot = None
            if not told:
                return 0
            try:
                robot = _enabled(name)
                answer = "done"
            except FailstopError as error:
                answer = str(error)
            print(answer, flush=True)
        with contextlib.suppress(FailstopError):
            if robot:
                robot.sensed()
                robot.drive(FORWARD_MPS, 0.0, 0.0)


def _enabled(name: str) -> Robot:
    """A connection to the run that is there now, with motion enabled. Raises FailstopError."""
    robot = Robot(name, client="driver", disable_on_exit=False)
    until_s = time.monotonic() + RESET_S
    try:
        while robot.state.estop:
            try:
                robot.reset()
            except Refused:
                if time.monotonic() > until_s:
                    raise
                time.sleep(EVERY_S)
        robot.enable()
    except BaseException:
        robot.close()
        raise
    return robot


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

"""failstop stops a robot when its software fails. This program drives until somebody stops it:

    import time
    from failstop import Robot

    with Robot() as robot:                  # the service that runs on this machine
        robot.wait_for("enabled")           # until a person types: failstop enable
        while robot.state.enabled:
            robot.sensed()                  # the obstacle sensor has just delivered a reading
            robot.drive(0.2, 0.0, 0.0)      # m/s forward, m/s left, rad/s counter-clockwise
            time.sleep(0.05)                # a command is valid for 0.3 s
        print(robot.why())                  # why it was stopped, what proves it, what to do
                                            # leaving `with` stops the wheels

If this program crashes, motion is disabled. So when it is started again, it waits for a person. For asyncio, use
Robot.connect(). Times are in s, lengths in m, angles in rad, voltages in V. The guide is docs/python.md.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused, TimedOut, Undeclared
    from failstop.api.events import Event
    from failstop.api.robot import Answer, AsyncRobot, Blocked, Driving, Preempted, Robot
    from failstop.api.snapshot import Block, Imu, Odometry, Pad, Process, State, Stop, Velocity
    from failstop.api.why import Why

__all__ = [
    "Answer", "AsyncRobot", "Block", "Blocked", "Driving", "Event", "FailstopError", "Imu", "NoAnswer", "NoService",
    "Odometry", "Pad", "Preempted", "Process", "Refused", "Robot", "State", "Stop", "TimedOut", "Undeclared",
    "Velocity", "Why", "__version__",
]  # fmt: skip

if "t" in sys.abiflags:
    raise ImportError(
        "failstop needs the standard build of Python, and this is the free-threaded one: nobody has checked yet in"
        f" which order its processes see shared memory there; next: use python"
        f"{sys.version_info[0]}.{sys.version_info[1]} without the t"
    )

_HOMES = ("errors", "snapshot", "events", "robot", "why")
"""The modules of failstop.api that define the public names. A module comes before the ones that import it, so that
looking up one name loads as few modules as possible."""


def __getattr__(name: str) -> object:
    """Import each public name when it is first used. The service's own processes import this package too, and must stay
    small."""
    if name == "__version__":
        from failstop.version import VERSION

        return VERSION
    for home in _HOMES if name in __all__ else ():
        module = __import__(f"failstop.api.{home}", fromlist=[name])
        if name in vars(module):
            found: object = vars(module)[name]
            return found
    raise AttributeError(f"module 'failstop' has no attribute {name!r}")

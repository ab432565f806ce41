"""failstop: the layer that makes a robot stop. This drives one for two seconds:

    import time
    from failstop import Robot

    with Robot() as robot:                          # the service that runs on this machine
        robot.reset()                               # clears a latched stop, if there is one
        robot.enable()                              # raises Refused, which says why not and what to do
        for _ in range(40):
            robot.sensed()                          # the obstacle sensor delivered just now
            if not robot.drive(0.2, 0.0, 0.0):      # m/s forward, m/s left, rad/s counter-clockwise
                print(robot.why())                  # what holds the wheels, what proves it, what to do
            time.sleep(0.05)                        # a command counts for 0.3 s
                                                    # leaving `with` stops the wheels and disables motion

Robot.connect() is the same for asyncio. Times are s, lengths m, angles rad, voltages V. More: docs/python.md.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.aio import AsyncRobot
    from failstop.api.driving import Answer, Blocked, Driving, Preempted
    from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused, TimedOut, Undeclared
    from failstop.api.events import Event
    from failstop.api.robot import Robot
    from failstop.api.snapshot import Block, Process, State, Stop, Velocity
    from failstop.api.why import Why

__all__ = [
    "Answer",
    "AsyncRobot",
    "Block",
    "Blocked",
    "Driving",
    "Event",
    "FailstopError",
    "NoAnswer",
    "NoService",
    "Preempted",
    "Process",
    "Refused",
    "Robot",
    "State",
    "Stop",
    "TimedOut",
    "Undeclared",
    "Velocity",
    "Why",
    "__version__",
]

_HOMES = {
    "Answer": "driving",
    "AsyncRobot": "aio",
    "Block": "snapshot",
    "Blocked": "driving",
    "Driving": "driving",
    "Event": "events",
    "FailstopError": "errors",
    "NoAnswer": "errors",
    "NoService": "errors",
    "Preempted": "driving",
    "Process": "snapshot",
    "Refused": "errors",
    "Robot": "robot",
    "State": "snapshot",
    "Stop": "snapshot",
    "TimedOut": "errors",
    "Undeclared": "errors",
    "Velocity": "snapshot",
    "Why": "why",
}


def __getattr__(name: str) -> object:
    """Public names are imported when first used: the processes of the service import this package too, and must stay
    small."""
    if name == "__version__":
        from failstop.version import VERSION

        return VERSION
    if name in _HOMES:
        module = __import__(f"failstop.api.{_HOMES[name]}", fromlist=[name])
        found: object = getattr(module, name)
        return found
    raise AttributeError(f"module 'failstop' has no attribute {name!r}")

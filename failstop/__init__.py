"""failstop: the layer that makes a robot stop.

from failstop import Robot
with Robot() as robot:
    robot.enable()
    robot.drive(0.2, 0.0, 0.0)
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.errors import FailstopError, NoAnswer, NoService, Refused, Undeclared
    from failstop.api.robot import Robot
    from failstop.api.state import Process, State, Stop

__all__ = [
    "FailstopError",
    "NoAnswer",
    "NoService",
    "Process",
    "Refused",
    "Robot",
    "State",
    "Stop",
    "Undeclared",
    "__version__",
]

_HOMES = {
    "FailstopError": "errors",
    "NoAnswer": "errors",
    "NoService": "errors",
    "Process": "state",
    "Refused": "errors",
    "Robot": "robot",
    "State": "state",
    "Stop": "state",
    "Undeclared": "errors",
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

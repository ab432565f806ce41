"""Fill: fills ROS messages from plain dictionaries, and finds message types by their names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from failstop.api.errors import FailstopError


def type_of(name: str) -> Any:
    """The class of a message type, for example of geometry_msgs/msg/Twist. Raises FailstopError."""
    package, kind, last = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), last)
    except (ImportError, AttributeError):
        debian = f"ros-{os.environ.get('ROS_DISTRO', 'humble')}-{package.replace('_', '-')}"
        raise FailstopError(f"this ROS has no {name}: install the package {package} (apt install {debian})") from None


def fill(message: Any, fields: Mapping[str, Any]) -> Any:
    """Set the fields of a message, and return the message. A dictionary sets the fields of a nested message."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message

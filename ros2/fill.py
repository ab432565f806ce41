"""Fill: plain dictionaries into ROS messages, and types by their names. Needs no ROS itself."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any


def type_of(name: str) -> Any:
    """The class of a type such as geometry_msgs/msg/Twist. Raises ImportError."""
    package, kind, last = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), last)


def fill(message: Any, fields: Mapping[str, Any]) -> Any:
    """Set a message's fields, those of messages within it by dictionaries; returns the message."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message

"""A stand-in for the calls of rclpy that the bridge and its tests make: real processes, sockets instead of DDS.

The same cases run against the real rclpy where there is one; what holds here and not there is a defect of this.
"""

from __future__ import annotations

from rclpy import types  # noqa: F401  (first: it makes the message packages)
from rclpy.node import Arguments, Node
from rclpy.wire import Wire

_wire: Wire | None = None
_arguments = Arguments([])


def init(*, args: list[str] | None = None, signal_handler_options: object = None) -> None:
    global _wire, _arguments
    _arguments = Arguments(args or [])
    _wire = Wire()


def ok() -> bool:
    return _wire is not None


def try_shutdown() -> None:
    global _wire
    if _wire:
        _wire.close()
        _wire = None


shutdown = try_shutdown


def create_node(name: str) -> Node:
    assert _wire is not None
    return Node(name, arguments=_arguments, wire=_wire)

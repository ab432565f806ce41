"""The stand-in installs no signal handlers; whoever wants rclpy's own has none."""

from enum import IntEnum


class SignalHandlerOptions(IntEnum):
    NO = 0

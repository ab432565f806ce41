"""Facts about an Arduino with ros_arduino_bridge. failstop needs them to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(speeds=2, imu=False)

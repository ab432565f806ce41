"""Facts about a hoverboard. failstop needs them to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(speeds=2, imu=False, battery=True)

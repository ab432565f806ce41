"""Facts about Waveshare's UGV. failstop needs them to read the settings, before it makes a Board."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(speeds=2, imu=True, battery=True)

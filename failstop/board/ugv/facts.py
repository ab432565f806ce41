"""What the settings must know about Waveshare's UGV before a Board is made."""

from __future__ import annotations

from failstop.board.facts import Facts

FACTS = Facts(speeds=2, imu=True)

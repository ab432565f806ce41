"""Proofs: the words for what is known of a stop and of the board that it went to, for people and in records. Pure."""

from __future__ import annotations

LINK_UNPROVEN = "unproven"
LINK_ALIVE = "alive"
LINK_DEAF = "deaf"
LINK_UNASKED = "unasked"
NOT_SENT = "NOT sent: the board takes no bytes"
"""For people: of bytes that the kernel was handed and holds (with cdc_acm; a pty that is full takes none)."""
RESOLUTION_S = 0.2
"""The IMU's word of when the wheels came to rest is no better than this."""
WINDOW_NS = 500_000_000
"""The span of IMU samples that one judgement of a standstill is made of."""
LEAST_SAMPLES = 20
"""In a window: fewer say too little about a standard deviation, and nothing is judged (an IMU of less than 40 Hz)."""


def still_after(seconds: float, less: str = "less than") -> str:
    """For people, to the resolution there is."""
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than") -> str:
    """The IMU's word for people, where the wheels were named before; 0: it saw no shaking before the stop either."""
    return f"still after {still_after(seconds, less)}" if seconds else "no shaking seen before or after"


def wheels_seen(seconds: float) -> str:
    """The IMU's word for people."""
    return f"wheels {still_or_unseen(seconds)}" if seconds else still_or_unseen(seconds)

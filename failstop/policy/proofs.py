"""Proofs: the words for what is known about a stop and about its board, for people and in records. Pure."""

from __future__ import annotations

LINK_UNPROVEN = "unproven"
LINK_ALIVE = "alive"
LINK_DEAF = "deaf"
LINK_UNHEARD = "unheard"
LINK_UNASKED = "unasked"
LINK_SILENT = "silent"
LINKS_IN_WORDS = {
    LINK_UNPROVEN: "the board has never answered",
    LINK_ALIVE: "the board answers",
    LINK_DEAF: "the board does NOT hear",
    LINK_SILENT: "the board says NOTHING any more",
    LINK_UNHEARD: "the board has NOT answered since its port came back",
    LINK_UNASKED: "this board answers no questions, by design",
}
"""For people: what each state of the link means."""
NOT_CONNECTED = (LINK_DEAF, LINK_SILENT, LINK_UNHEARD)
"""In these states a stop may not reach the wheels, or nobody would see that it did not."""
WAITS_FOR = {
    LINK_DEAF: "the board, which does not hear",
    LINK_SILENT: "the board, which says nothing any more",
    LINK_UNHEARD: "the board, which has not answered since its port came back",
}
"""For people: what motion waits for in these states."""
TO_A_STRANGER = "to a device that has not answered as the board does"
"""For people: about bytes that the kernel has passed on to an unknown device."""
NOT_SENT = "NOT sent: the board accepts no bytes"
"""For people: about bytes that the kernel took and still holds (with cdc_acm; a full pty takes none)."""
ACKNOWLEDGED_BY = {"answer": "the board", "echo": "the board's echo"}
"""For people: what acknowledges a stop, by the board interface's word."""
UNMOVED = "not acknowledged, because this board's echo shows only a stop that ends motion"
"""For people: about a board without pings whose echo was zero already, or did not say that it moves."""
SEEN_BY = {"IMU": "the IMU", "wheels": "the board's own reports"}
"""For people: what observed the wheels, by the board interface's word. If nothing does: NO_IMU."""
NO_IMU = "not observed: the robot has no IMU"
NEVER_SEEN = {"IMU": "no shaking seen before or after", "wheels": "not seen turning before or after"}
"""For people: the observer saw no motion that could have come to rest."""
ALTHOUGH_TOLD_ZERO = {
    "wheels": "the wheels turn although they are told to stop",
    "IMU": "the robot moves, or is being moved, although its wheels are told to stop",
}
"""For people: about wheels that turn for longer than they may, by their observer."""
WATCHDOGS = {"zero": "it stops its wheels", "coast": "it lets its wheels coast", "disarm": "it disarms its motors"}
"""For people: what the board's own watchdog does, by the board interface's word."""
RESOLUTION_S = 0.2
"""The IMU can't time the wheels' rest any better than this."""
WINDOW_NS = 500_000_000
"""The span of IMU samples that one judgement of a standstill is made of."""
LEAST_SAMPLES = 20
"""If a window has fewer samples than this, nothing is judged (an IMU below 40 Hz), because a standard deviation of so
few samples says too little."""


def observer(boards: str, *, imu: bool) -> str:
    """What observes that the wheels are at rest, given the board interface's word; empty if it is an IMU that the robot
    lacks."""
    return boards if imu or boards != "IMU" else ""


def still_after(seconds: float, less: str = "less than") -> str:
    """For people: the time until the wheels were still, no finer than it is known."""
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than", by: str = "IMU") -> str:
    """For people, after a text that named the wheels; 0 seconds: the observer saw no motion before the stop either."""
    return f"still after {still_after(seconds, less)}" if seconds else NEVER_SEEN[by]


def wheels_seen(seconds: float, by: str = "IMU") -> str:
    """For people: when the wheels came to rest, and what observed it."""
    return f"wheels {still_or_unseen(seconds)}" if seconds else NEVER_SEEN[by]

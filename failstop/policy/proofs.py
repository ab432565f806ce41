"""Proofs: the words for what is known of a stop and of the board that it went to, for people and in records. Pure."""

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
    LINK_UNASKED: "this board answers no question, by its nature",
}
"""For people: what each state of the link means."""
NOT_CONNECTED = (LINK_DEAF, LINK_SILENT, LINK_UNHEARD)
"""A stop may not reach the wheels in these states, or nobody would see that it did not."""
WAITS_FOR = {
    LINK_DEAF: "the board, which does not hear",
    LINK_SILENT: "the board, which says nothing any more",
    LINK_UNHEARD: "the board, which has not answered since its port came back",
}
"""For people: what motion waits for in these states."""
TO_A_STRANGER = "to a device that has not answered as the board does"
"""For people: of bytes that the kernel has passed on, to whom nobody knows."""
NOT_SENT = "NOT sent: the board takes no bytes"
"""For people: of bytes that the kernel was handed and holds (with cdc_acm; a pty that is full takes none)."""
ACKNOWLEDGED_BY = {"answer": "the board", "echo": "the board's echo"}
"""For people: what acknowledges a stop, by the word of the board's interface."""
UNMOVED = "not acknowledged: the board's echo shows a stop only where it ends motion"
"""For people: of a board that is asked nothing and whose echo was zero already, or did not say that it moves."""
SEEN_BY = {"IMU": "the IMU", "wheels": "the board's own reports"}
"""For people: what observes that the wheels stand, likewise. By nothing: NO_IMU."""
NO_IMU = "not observed: the robot has no IMU"
NEVER_SEEN = {"IMU": "no shaking seen before or after", "wheels": "not seen turning before or after"}
"""For people: what observes saw nothing to come to rest."""
ALTHOUGH_TOLD_ZERO = {
    "wheels": "the wheels turn although they are told zero",
    "IMU": "the robot moves, or is being moved, although its wheels are told zero",
}
"""For people: wheels that turn on for longer than they may, by what says so."""
WATCHDOGS = {"zero": "it stops its wheels", "coast": "its wheels roll on without current", "disarm": "it disarms"}
"""For people: what the board's own watchdog does, by its word."""
RESOLUTION_S = 0.2
"""The IMU's word of when the wheels came to rest is no better than this."""
WINDOW_NS = 500_000_000
"""The span of IMU samples that one judgement of a standstill is made of."""
LEAST_SAMPLES = 20
"""In a window: fewer say too little about a standard deviation, and nothing is judged (an IMU of less than 40 Hz)."""


def observer(boards: str, *, imu: bool) -> str:
    """The observer of wheels at rest, by the word of the board's interface; empty: an IMU that the robot lacks."""
    return boards if imu or boards != "IMU" else ""


def still_after(seconds: float, less: str = "less than") -> str:
    """For people, to the resolution there is."""
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than", by: str = "IMU") -> str:
    """For people, where the wheels were named before; 0: what observes saw nothing move before the stop either."""
    return f"still after {still_after(seconds, less)}" if seconds else NEVER_SEEN[by]


def wheels_seen(seconds: float, by: str = "IMU") -> str:
    """For people."""
    return f"wheels {still_or_unseen(seconds)}" if seconds else NEVER_SEEN[by]

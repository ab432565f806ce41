"""Proofs: the words, for people and in records, for what is known about a stop and about the board. Pure."""

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
"""What each state of the link means, for people."""
NOT_CONNECTED = (LINK_DEAF, LINK_SILENT, LINK_UNHEARD)
"""States of the link in which a stop may not reach the wheels, or nobody would see that it did not."""
WAITS_FOR = {
    LINK_DEAF: "the board, which does not hear",
    LINK_SILENT: "the board, which says nothing any more",
    LINK_UNHEARD: "the board, which has not answered since its port came back",
}
"""What motion waits for in each of these states, for people."""
TO_A_STRANGER = "to a device that has not answered as the board does"
"""The text about bytes that the kernel has passed on to an unknown device."""
NOT_SENT = "NOT sent: the board accepts no bytes"
"""The text about bytes that the kernel has taken and still holds (with cdc_acm; a full pty takes none)."""
ACKNOWLEDGED_BY = {"answer": "the board", "echo": "the board's echo"}
"""What acknowledges a stop, for people, by the board interface's word."""
UNMOVED = "not acknowledged, because this board's echo shows only a stop that ends motion"
"""The text about a board without pings that reported zero already before the stop, or did not report that it moves."""
SEEN_BY = {"IMU": "the IMU", "wheels": "the board's own reports"}
"""What observed the wheels, for people, by the board interface's word. If nothing did: NO_IMU."""
NO_IMU = "not observed: the robot has no IMU"
NEVER_SEEN = {"IMU": "no shaking seen before or after", "wheels": "not seen turning before or after"}
"""The text for a stop before which the observer saw no motion, so that nothing could come to rest."""
ALTHOUGH_TOLD_ZERO = {
    "wheels": "the wheels turn although they are told to stop",
    "IMU": "the robot moves, or is being moved, although its wheels are told to stop",
}
"""The text about wheels that turn for longer than they may, by the observer."""
WATCHDOGS = {"zero": "it stops its wheels", "coast": "it lets its wheels coast", "disarm": "it disarms its motors"}
"""What the board's own watchdog does, for people, by the board interface's word."""
RESOLUTION_S = 0.2
"""How exactly the IMU can time when the wheels came to rest, s."""
WINDOW_NS = 500_000_000
"""How long the window of IMU samples is from which one judgement is made."""
LEAST_SAMPLES = 20
"""If a window has fewer samples (an IMU below 40 Hz), nothing is judged, because their standard deviation says too
little."""


HEARD_LATE = " (heard once telemetry was back)"
"""For people, after the time of an answer or of a report: the process that hears them had died or hung, so
the board may have answered earlier, and the wheels may have stopped earlier."""


def heard_late(process: object) -> str:
    """For people, after such a time, in a stop whose cause is about this process; empty: it was heard at once."""
    return HEARD_LATE if process == "telemetry" else ""


def observer(boards: str, *, imu: bool) -> str:
    """What observes that the wheels are at rest, given the board interface's word; empty if it is an IMU that the robot
    lacks."""
    return boards if imu or boards != "IMU" else ""


def still_after(seconds: float, less: str = "less than") -> str:
    """The time until the wheels were still, for people, with no more digits than are known."""
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than", by: str = "IMU") -> str:
    """A text that continues after the wheels were named: when they were still. 0 seconds: the observer saw no motion
    before the stop either."""
    return f"still after {still_after(seconds, less)}" if seconds else NEVER_SEEN[by]


def wheels_seen(seconds: float, by: str = "IMU") -> str:
    """A text that says when the wheels came to rest, and what observed it."""
    return f"wheels {still_or_unseen(seconds)}" if seconds else NEVER_SEEN[by]

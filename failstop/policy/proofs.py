"""Proofs: the texts about how well a stop is proven, and about the connection to the board. Pure."""

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
"""The text for people about each state of the connection to the board."""
NOT_CONNECTED = (LINK_DEAF, LINK_SILENT, LINK_UNHEARD)
"""In these states of the connection, a stop may not reach the wheels, or nobody could see that it did not."""
WAITS_FOR = {
    LINK_DEAF: "the board, which does not hear",
    LINK_SILENT: "the board, which says nothing any more",
    LINK_UNHEARD: "the board, which has not answered since its port came back",
}
"""For the states in NOT_CONNECTED, the text that says what motion is waiting for."""
TO_A_STRANGER = "to a device that has not answered as the board does"
"""This text says that the bytes of a stop went to an unknown device, which may not be the board."""
NOT_SENT = "NOT sent: the board accepts no bytes"
"""This text says that the bytes of a stop have not left the kernel, because the board accepts none. With the cdc_acm
driver the kernel can hold them; a full pty takes none."""
ACKNOWLEDGED_BY = {"answer": "the board", "echo": "the board's echo"}
"""What can acknowledge a stop, in words for people. The keys are the words of the board interface."""
UNMOVED = "not acknowledged, because this board's echo shows only a stop that ends motion"
"""The reason why a stop is not acknowledged although the board is connected. This board answers no pings, and it
reported zero speed already before the stop, or it did not report that it moves."""
SEEN_BY = {"IMU": "the IMU", "wheels": "the board's own reports"}
"""What can observe the wheels, in words for people. The keys are the words of the board interface. If nothing observes
the wheels, the text is NO_IMU."""
NO_IMU = "not observed: the robot has no IMU"
NEVER_SEEN = {"IMU": "no shaking seen before or after", "wheels": "not seen turning before or after"}
"""If the observer saw no motion before the stop either, nothing could be seen to come to rest. This is the text for
that case. The keys are the observers."""
ALTHOUGH_TOLD_ZERO = {
    "wheels": "the wheels turn although they are told to stop",
    "IMU": "the robot moves, or is being moved, although its wheels are told to stop",
}
"""The text about wheels that keep turning after a stop for longer than is allowed. The keys are the observers."""
WATCHDOGS = {"zero": "it stops its wheels", "coast": "it lets its wheels coast", "disarm": "it disarms its motors"}
"""What the board's own watchdog does, in words for people. The keys are the words of the board interface."""
RESOLUTION_S = 0.2
"""How exactly the IMU shows when the wheels came to rest, in seconds."""
WINDOW_NS = 500_000_000
"""The length of the window of IMU samples that is judged as one, in ns."""
LEAST_SAMPLES = 20
"""A window with fewer samples (an IMU below 40 Hz) is not judged, because their standard deviation is too inexact."""


HEARD_LATE = " (heard once telemetry was back)"
"""This text follows the time of an answer or report that telemetry received late, because telemetry had died or hung.
The board may have answered earlier, and the wheels may have stopped earlier, than the time says."""


def heard_late(process: object) -> str:
    """A text to add to the time of an answer after a stop. `process`: the process that the cause of the stop is about.
    If that is telemetry, the answer was received late, and the text is HEARD_LATE. Otherwise it is empty."""
    return HEARD_LATE if process == "telemetry" else ""


def observer(boards: str, *, imu: bool) -> str:
    """What observes that the wheels are at rest. `boards`: the board interface's name for its observer. Empty if that
    is an IMU, and the robot has none."""
    return boards if imu or boards != "IMU" else ""


def still_after(seconds: float, less: str = "less than") -> str:
    """How long it took until the wheels were still, as text. It has no more digits than are known."""
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than", by: str = "IMU") -> str:
    """A text that follows the name of the wheels, and says how long it took until they were still. If `seconds` is 0,
    the observer saw no motion before the stop either, and the text says so."""
    return f"still after {still_after(seconds, less)}" if seconds else NEVER_SEEN[by]


def wheels_seen(seconds: float, by: str = "IMU") -> str:
    """A text that says how long it took until the wheels were still, or that they were not seen moving."""
    return f"wheels {still_or_unseen(seconds)}" if seconds else NEVER_SEEN[by]

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
"""The states of the connection in which a stop may not reach the wheels, or in which failstop could not tell whether it
did."""
WAITS_FOR = {
    LINK_DEAF: "the board, which does not hear",
    LINK_SILENT: "the board, which says nothing any more",
    LINK_UNHEARD: "the board, which has not answered since its port came back",
}
"""What motion is waiting for in each of the states NOT_CONNECTED, and why. The text can follow the words "wait for"."""
TO_A_STRANGER = "to a device that has not answered as the board does"
"""Says that a stop was written to a device that is perhaps not the board. These words follow the time of the stop."""
NOT_SENT = "NOT sent: the board accepts no bytes"
"""Says that the bytes of a stop have not left the kernel, because the board accepts none. With the cdc_acm driver, for
example, the kernel keeps them until the board accepts them."""
ACKNOWLEDGED_BY = {"answer": "the board", "echo": "the board's echo"}
"""What can acknowledge a stop, in words for people. The keys are those of board/interface.py."""
UNMOVED = "not acknowledged, because this board's echo shows only a stop that ends motion"
"""The reason why a stop is not acknowledged although the board is connected. A board that answers no pings can
acknowledge a stop only by reporting that its speed changes to zero. If it already reported zero before the stop, there
is no such change. See unmoved()."""
SEEN_BY = {"IMU": "the IMU", "wheels": "the board's own reports"}
"""What can observe the wheels, in words for people. The keys are those of board/interface.py. If nothing observes the
wheels, the text is NO_IMU."""
NO_IMU = "not observed: the robot has no IMU"
NEVER_SEEN = {"IMU": "no shaking seen before or after", "wheels": "not seen turning before or after"}
"""The text if the observer saw no motion before a stop, and so can't see the wheels come to rest. The keys are the
observers."""
ALTHOUGH_TOLD_ZERO = {
    "wheels": "the wheels turn although they are told to stop",
    "IMU": "the robot moves, or is being moved, although its wheels are told to stop",
}
"""The text if the wheels turn for longer after a stop than is allowed. The keys are the observers."""
WATCHDOGS = {"zero": "it stops its wheels", "coast": "it lets its wheels coast", "disarm": "it disarms its motors"}
"""What the board's own watchdog does, in words for people. The keys are those of board/wire.py."""
RESOLUTION_S = 0.2
"""How exactly the IMU shows when the wheels came to rest, in seconds."""
WINDOW_NS = 500_000_000
"""The IMU's samples are judged in windows of this length, in ns. Each window gives one verdict: still or not."""
LEAST_SAMPLES = 20
"""A window of 0.5 s with fewer samples than this is not judged, because the standard deviation of so few samples is too
inexact. So an IMU must send at least 40 samples per second."""


HEARD_LATE = " (heard once telemetry was back)"
"""Follows the time of an answer or report if telemetry received it late, because telemetry had died or hung. The board
may have answered, or the wheels may have stopped, before that time."""


def heard_late(process: object) -> str:
    """Return HEARD_LATE if `process` is telemetry, otherwise an empty text. `process`: the process that caused a stop,
    for example by its death. Without telemetry, answers are received late."""
    return HEARD_LATE if process == "telemetry" else ""


def observer(boards: str, *, imu: bool) -> str:
    """What observes the wheels. `boards`: what observes them with this kind of board, `IMU` or `wheels`. `imu`: True if
    the robot has an IMU. The result is `boards`, or empty if `boards` is `IMU` and the robot has no IMU."""
    return boards if imu or boards != "IMU" else ""


def still_after(seconds: float, less: str = "less than", *, late: bool = False) -> str:
    """The time until the wheels were still, as a text with no more digits than the measurement justifies. `late`: True
    if nothing showed the wheels for a while before, so that they may have stopped earlier."""
    if late and seconds >= RESOLUTION_S:
        return f"at most {seconds:.1f} s"
    return f"{less} {RESOLUTION_S:g} s" if seconds < RESOLUTION_S else f"about {seconds:.1f} s"


def still_or_unseen(seconds: float, less: str = "less than", by: str = "IMU", *, late: bool = False) -> str:
    """A text that follows the word "wheels": how long it took until they were still. If `seconds` is 0, the text says
    that no motion was seen even before the stop. `late`: see still_after()."""
    return f"still after {still_after(seconds, less, late=late)}" if seconds else NEVER_SEEN[by]


def wheels_seen(seconds: float, by: str = "IMU", *, late: bool = False) -> str:
    """A text that says how long it took until the wheels were still, or that they were not seen moving. `late`: see
    still_after()."""
    return f"wheels {still_or_unseen(seconds, late=late)}" if seconds else NEVER_SEEN[by]


def unmoved(observed: float | None, by: str) -> bool:
    """True if UNMOVED may be why a board that acknowledges by its echo has not acknowledged a stop. False if the
    board's own reports show that the stop had a motion to end, or do not show the wheels still. `observed`: the time
    until the wheels were seen still, 0 if they were still before, or None if they were not seen still. `by`: what
    observes them."""
    return observed == 0 or by != "wheels"

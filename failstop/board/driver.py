"""Driver languages: what a driver program may write to a board, and what it gets back, for the guard port.

A driver is somebody else's program that was written for the bare board. The guard port (failstop/guard) gives it a
pseudo-terminal that behaves like the board. How the board behaves is in the board's own folder, as a DriverLanguage: it
takes the driver's bytes and returns what they ask for. A language is pure: it does no I/O, it gets every time as an
argument, and it never raises on bytes.

It returns rows of four kinds:

- DriverMotion: the speeds of all wheels. The service decides whether they turn; no other row can move anything.
- DriverAnswer: bytes for the driver, which the language makes from the board's newest reports.
- DriverFrame: bytes for the board that move nothing, such as a light or one of its questions.
- DriverRefusal: something that the driver has asked for and does not get. People read it once for each driver.

So a refused question has two rows (a refusal, and an answer that keeps the driver going), and raw PWM has three (a
refusal, a motion of zeros, an answer).
"""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Protocol

    Settings = Mapping[str, float | str]

    class DriverLanguage(Protocol):
        """One driver's conversation with the board. The guard makes a new object for each program that opens the
        port.

        It also makes a new one when the service is started again while the driver keeps the port open. If the language
        has a method `resume(before)`, the guard then gives it the object before, so that it can go on with values that
        must not jump for the driver, such as counts that began at zero when the driver opened the port."""

        openers: int
        """How many programs the usual driver of this board consists of. It is two if one of its programs writes to the
        port and another one reads."""
        patience_ns: int
        """How long a driver waits for an answer. If the driver was away for longer, the guard answers only its newest
        question, because a driver that has given up would take a late answer for the one to its next question."""
        past_ns: int
        """How much of what the board said before the driver opened the port is given to heard() first, a few seconds at
        most. What heard() returns then is dropped, because it is old. 0: nothing, as after the reset of a board."""

        def wrote(self, chunk: bytes, now_ns: int) -> list[DriverMotion | DriverAnswer | DriverFrame | DriverRefusal]:
            """The driver wrote these bytes, split and glued in any way. Returns what they ask for, in order. It has to
            accept each spelling that the board's own receiver accepts. It must never find a motion if that receiver
            would find none, nor a faster one. Bytes of an incomplete frame are kept, up to a limit."""

        def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
            """The board sent these bytes, at that time. Returns what to pass on to the driver, in whole frames or
            lines. Reports that come without a question are passed on, but not the answers to failstop's own questions.
            For a board that only answers, this returns nothing; the language then answers the next question with what
            it has learned."""


class DriverMotion(Data):
    """The speeds of all wheels by wire id, in the unit of the board's motion (wire.Motion). Zeros are a stop: the
    driver no longer drives. If a driver's frame names only some wheels, the others keep the speed that they were given
    before. A language refuses what its board would refuse, and leaves the limits to the service."""

    speeds: Sequence[float]
    refused: bool = False
    """True for a stop in place of a refused command. If the driver dies after it, it was still driving, because it did
    not ask for that stop."""
    steering_rad: float | None = None
    """The angle of the steered wheels, positive to the left; None if the base is not steered, or its wheels' speeds say
    how it turns."""


class DriverAnswer(Data):
    """Bytes for the driver: one whole answer. All of it is written at once, or nothing."""

    data: bytes


class DriverFrame(Data):
    """Bytes for the board: one of its questions, or a frame that its wire.aux lets pass. The guard passes on fifty a
    second at most. If several frames of one kind wait, only the newest is passed on."""

    data: bytes
    kind: str = ""
    """What the frame sets. A newer frame of the same kind replaces one that still waits."""


class DriverRefusal(Data):
    """A request of the driver that is refused."""

    what: str
    """For people, and the same text each time: what the driver asked for, for example "raw PWM (o)". If the driver asks
    again, it is not reported again."""
    why: str
    """For people: what failstop did instead, and what helps, for example "its wheels were stopped: use m"."""


def language_of(kind: str, settings: Settings) -> DriverLanguage | None:
    """A new conversation with the board of the setting board.kind; None if nobody has described what a driver may write
    to this board. `settings`: every setting by its whole key. Raises ValueError."""
    from failstop.board import kinds

    if kinds.is_described(kind):
        make = kinds.wire_of(kind).driver
        try:
            return make(settings) if make else None
        except (ImportError, AttributeError, TypeError) as error:
            remedy = 'correct it ("The guard port" in docs/porting.md), or take `driver` out of its Wire'
            raise ValueError(
                f"{kind}/wire.py: its `driver` raises {type(error).__name__}: {error}: {remedy}"
            ) from error
    try:
        module = __import__(f"failstop.board.{kind}.driver", fromlist=["language"])
    except ModuleNotFoundError:
        return None
    found: DriverLanguage = module.language(settings)
    return found

"""Driver languages: what a driver program may write to a board through the guard port, and what it gets back.

A driver is a program that somebody else wrote for the bare board. The guard port (failstop/guard) gives it a
pseudo-terminal that behaves like the board. The DriverLanguage in the board's own folder reads the driver's bytes, and
returns what the driver asks for. A language is pure: it does no I/O, it gets every time as an argument, and it never
raises on bytes.

A language returns rows of four kinds:

- DriverMotion: the speeds of all wheels. The service decides whether they turn. No other kind of row can move anything.
- DriverAnswer: bytes for the driver, which the language makes from the board's newest reports.
- DriverFrame: bytes for the board that move nothing, for example a light or a question.
- DriverRefusal: something that the driver asked for and does not get. It is shown to people once for each driver.

One request may need several rows. For example, a refused question becomes a DriverRefusal, and a DriverAnswer so that
the driver does not wait forever. Refused raw PWM becomes a DriverRefusal, a DriverMotion of zeros, and a DriverAnswer.
"""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any, Protocol

    Settings = Mapping[str, float | str]

    class DriverLanguage(Protocol):
        """One driver's conversation with the board. The guard makes a new object for each program that opens the port.
        It also makes a new object if the service restarts while the driver keeps the port open, and if one of several
        programs closes the port. It then calls resume() of the new object.
        """

        openers: int
        """How many programs the usual driver of this board consists of. It is 2 if one of its programs writes to the
        port and another one reads."""
        patience_ns: int
        """How long a driver waits for an answer, in ns. If the driver was away for longer, the guard answers only its
        newest question. The driver would take a late answer for the answer to its next question."""
        past_ns: int
        """In ns. heard() first gets what the board sent during this time before the driver opened the port, a few
        seconds at most. The guard drops what heard() returns for these bytes, because it is old. With 0, the language
        begins with nothing, as after a reset of the board."""

        def wrote(self, chunk: bytes, now_ns: int) -> list[DriverMotion | DriverAnswer | DriverFrame | DriverRefusal]:
            """Return the rows that these bytes from the driver ask for, in order. The bytes may be split or joined in
            any way. Accept every spelling that the board's own receiver accepts. Never find motion that the receiver
            would not find, or a faster one. Keep the bytes of an incomplete frame, up to a limit."""

        def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
            """Handle bytes that the board sent, and return the bytes for the driver, in whole frames or lines. Pass on
            reports that come unasked, but not the answers to failstop's own questions. For a board that only answers,
            return an empty list, and use its answers for the driver's next question."""

        def resume(self, before: Any) -> None:
            """Continue the conversation of `before`, an object of the same class, with the same driver. Copy what the
            driver has set up, for example which motors it has disabled, because it won't do so again. Copy values that
            must not jump for the driver, for example counts that began at zero when it opened the port, and the bytes
            of an incomplete frame. Don't copy speeds, because nothing may turn before the driver commands it again. Do
            nothing if each of the driver's frames stands alone. `before` must stay as it is."""


class DriverMotion(Data):
    """The speeds of all wheels by wire id, in the unit of the board's motion (wire.Motion). Zeros are a stop. Unless
    `refused` is True, they also mean that the driver has ended driving. Wheels that the driver's frame does not name
    keep the speeds commanded before. If each motor has a watchdog of its own, they keep them only for as long as that
    watchdog would allow. A language refuses what its board would refuse, and leaves the speed limits to the service."""

    speeds: Sequence[float]
    refused: bool = False
    """True for a stop that replaces a refused command. The driver did not ask for this stop, so the driver still counts
    as driving. If the driver dies next, failstop reports that it died while driving."""
    steering_rad: float | None = None
    """The angle of the steered wheels in radians, positive to the left. None if the base has no steered wheels, or if
    the speeds of the wheels already say how the base turns."""
    renews: bool = True
    """False for a frame that changes only the steering. Its speeds are those that the driver commanded before, and stay
    as old as they were, so a driver that only steers can't keep the wheels turning."""


class DriverAnswer(Data):
    """Bytes for the driver: one whole answer. The guard writes either all of it at once or none of it."""

    data: bytes


class DriverFrame(Data):
    """Bytes for the board: one of the board's questions, or a frame that `aux` of the board's Wire accepts. The guard
    passes on at most fifty frames per second. If several frames of the same kind wait, only the newest is passed on."""

    data: bytes
    kind: str = ""
    """What the frame sets or asks for, for example "counts". A newer frame of the same kind replaces an older one that
    has not been passed on yet."""
    asks: bool = False
    """True for a question that failstop does not answer itself, so the driver gets the board's own answer. A dry run
    has no board, and warns that no answer comes."""


class DriverRefusal(Data):
    """A request of the driver that is refused."""

    what: str
    """What the driver asked for, in words for people, for example "raw PWM (o)". A repeated request must have the same
    text each time, so that it is reported only once."""
    why: str
    """What failstop did instead and what helps, in words for people, for example "its wheels were stopped: use m"."""


def language_of(kind: str, settings: Settings) -> DriverLanguage | None:
    """Make the DriverLanguage for one driver. `kind`: the setting board.kind. `settings`: every setting by its full
    key. Returns None if nobody has described what a driver may write to this board. Raises ValueError if a setting does
    not fit the board, or if the `driver` of the board's Wire fails."""
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

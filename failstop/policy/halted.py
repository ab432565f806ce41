"""Halted: what a command may say about the wheels after it has tried to stop them. Pure.

A command says "stopped" only for what it has observed: a stop that went out whole and, if the board can confirm one,
the board's own answer after it. Otherwise it says that a wheel may still be turning.
"""

from __future__ import annotations

from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

REPORTED = "the wheels are stopped, as {by} reports"
MAY_TURN = "a wheel may still be turning, so switch off the power"
PORT_AWAY = f"{{where}} is unplugged: {MAY_TURN}"
NOTHING_WRITTEN = f"no stop could be written to {{where}}{{why}}: {MAY_TURN}"
STILL_TURNS = "a stop was written to {where}, but {by} reports that a wheel still turns: switch off the power"
NOT_CONFIRMED = f"a stop was written to {{where}}, but the board did not confirm it: {MAY_TURN}"
CONFIRMED = "the board has confirmed the stop"
UNCONFIRMABLE = "a stop was written to {where}, but nothing can confirm it: check that no wheel turns"
OF_CTRL_C = 130
"""The exit code of a command that Ctrl-C ended."""


class Halted(Data):
    """What is known after a command has tried to stop the wheels."""

    where: str
    """The port or the topic that the stop was sent to."""
    written: bool
    """True if a whole stop has left this computer."""
    there: bool = True
    """True if the port exists."""
    why: str = ""
    """Why no stop could be written."""
    confirms: bool = False
    """True if this board can confirm a stop."""
    confirmed: bool = False
    """True if the board has answered a question that followed the stop."""
    still: bool | None = None
    """True if the wheels were reported at rest after the stop, False if not; None if nothing reports them."""
    by: str = "the board"
    """What reports about the wheels, for example "the board"."""

    @property
    def safe(self) -> bool:
        """True if nothing known says that a wheel may still be turning."""
        return self._row()[1]

    def sentence(self) -> str:
        """What may be said about the wheels, without the final full stop."""
        return self._row()[2].format(where=self.where, by=self.by, why=f" ({self.why})" if self.why else "")

    def interrupted(self) -> int:
        """The exit code of a command that Ctrl-C ended."""
        return OF_CTRL_C if self.safe else 1

    def _row(self) -> tuple[Callable[[Halted], bool], bool, str]:
        return next(row for row in SENTENCES if row[0](self))


SENTENCES: tuple[tuple[Callable[[Halted], bool], bool, str], ...] = (
    (lambda known: not (known.written or known.there), False, PORT_AWAY),
    (lambda known: not known.written, False, NOTHING_WRITTEN),
    (lambda known: known.still is False, False, STILL_TURNS),
    (lambda known: known.confirms and not known.confirmed, False, NOT_CONFIRMED),
    (lambda known: known.still is True, True, REPORTED),
    (lambda known: known.confirmed, True, CONFIRMED),
    (lambda _: True, True, UNCONFIRMABLE),
)
"""Rows of a condition, True if the wheels are then safe, and the sentence. The first row whose condition holds
decides."""

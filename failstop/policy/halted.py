"""Halted: the sentence that a command prints about the wheels after it has tried to stop them. Pure.

The sentence warns if there is a reason to think that a wheel may still be turning, for example if the board can confirm
a stop but has not. It says that the wheels are stopped only if they were observed to be at rest. Otherwise it says only
what is known, for example that the board has confirmed the stop.
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
"""The exit code of a command that Ctrl-C has ended, if there is no reason to think that a wheel may still be
turning."""


class Halted(Data):
    """What a command knows after it has tried to stop the wheels."""

    where: str
    """The port or the topic to which the stop was sent."""
    written: bool
    """True if all bytes of a stop have left this computer, and the port has not disappeared since."""
    there: bool = True
    """True if the port exists."""
    why: str = ""
    """The error that kept the command from writing the stop, or from asking the board about it. Empty if there was no
    error."""
    confirms: bool = False
    """True if this board can confirm a stop. Also True if a stop was written, but the board could not be asked."""
    confirmed: bool = False
    """True if the board has answered a question that was sent after the stop."""
    still: bool | None = None
    """True if the wheels are reported to be at rest after the stop. False if a wheel is reported to be turning. None if
    nothing reports about the wheels."""
    by: str = "the board"
    """What reports about the wheels, in words."""

    @property
    def safe(self) -> bool:
        """True unless there is a reason to think that a wheel may still be turning."""
        return self._row()[1]

    def sentence(self) -> str:
        """The sentence about the wheels, without its full stop."""
        return self._row()[2].format(where=self.where, by=self.by, why=f" ({self.why})" if self.why else "")

    def interrupted(self) -> int:
        """The exit code of a command that Ctrl-C has ended: 1 if a wheel may still be turning, otherwise OF_CTRL_C."""
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
"""The possible sentences. Each row has three values: a condition, the value of `safe`, and the sentence. The first row
whose condition holds is used."""

"""OneByOne: a receiver that is told the speed of each motor by a frame of its own.

Judges know frames for all wheels alone. So frames for the motors in their order, one right behind the other, count as
one command. A frame that is not followed by the one for the next motor is a command too: a stop that reached only some
of the motors must not look like none, and not like a whole one either.
"""

from __future__ import annotations

from failstop_lab.boards.line import Rolling

JOINED_NS = 3_000_000
"""A frame for the next motor follows the one before it within this."""


class OneByOne(Rolling):
    """Keeps `commands`, by wheels()."""

    def __init__(self, *, joined: bool) -> None:
        """`joined`: frames for all motors, one right behind the other, are one command; False: each frame is one."""
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self._joined = joined
        self._begun: tuple[int, tuple[float, ...], int] | None = None
        """A command to some motors: when, the speeds, and the motor that may be told next."""

    def commanded(self, motor: int, at_ns: int) -> None:
        """The motor of this number, from 0, was told a speed, which wheels() has now."""
        if self._begun and self._begun[2] == motor:
            self._begun = None
        self._end()
        if motor == len(self.wheels) - 1 or not self._joined:
            self.commands.append((at_ns, self.wheels))
        else:
            self._begun = at_ns, self.wheels, motor + 1

    def pass_commands(self, at_ns: int) -> None:
        """Time passes: a command that was not followed by one to the next motor is over."""
        if self._begun and at_ns - self._begun[0] > JOINED_NS:
            self._end()

    def _end(self) -> None:
        if self._begun:
            self.commands.append(self._begun[:2])
            self._begun = None

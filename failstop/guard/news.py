"""News: what a Door reports about the programs that have the port open."""

from __future__ import annotations

from failstop.data import Data


class Opener(Data):
    """A program that has opened the port and still has it open."""

    pid: int
    name: str
    times: int
    """How many times the program has the port open. Copied descriptors don't count."""

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


class HungUp(Exception):
    """Somebody has hung up the pseudo-terminal, so the guard must open a new one."""


class News:
    """What a Door has noticed between two calls of look()."""

    def __init__(self) -> None:
        self.any = False
        """True if the guard must find out again which programs have the port open, because a program may have opened or
        closed the port, or may have ended."""
        self.ended = False
        """True if a program that had the port open has closed it, or is dying or dead."""
        self.emptied = False
        """True if there was a moment in which no program had the port open. It may have been opened again since."""
        self.orphans: list[Opener] = []
        """Programs that have died while one of their children still has the port open."""

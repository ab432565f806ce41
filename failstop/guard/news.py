"""News: what a door says of the programs that have the port open."""

from __future__ import annotations

from failstop.data import Data


class Opener(Data):
    """A program that has opened it and still has it open."""

    pid: int
    name: str
    times: int
    """How often it has opened it; descriptors that it has copied are no more openings."""

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


class HungUp(Exception):
    """Somebody has hung the terminal up, so another one has to take its place."""


class News:
    """What has happened at the door since the last look."""

    def __init__(self) -> None:
        self.any = False
        """Something has: it is worth looking who has it open now."""
        self.ended = False
        """A program that had it open has closed it, or is dying or dead."""
        self.orphans: list[Opener] = []
        """Programs that are gone, or have closed it, and have left it open with a child."""

"""A person at a terminal of 80 columns, who answers setup by what the simulated board's wheels do."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from failstop_lab.sim.client import Event, SimBoard
from tests.support.commands import FAILSTOP
from tests.support.terminal import Terminal

PATIENCE_S = 90.0
"""On a machine that is busy; nothing here depends on how long it takes."""


class Person(Terminal):
    """A context manager: `failstop setup` in a terminal."""

    def __init__(self, place: Path, *words: str) -> None:
        """`place`: where it keeps everything."""
        environ = {"STATE_DIRECTORY": str(place / "state"), "FAILSTOP_ROOT": str(place)}
        super().__init__(*FAILSTOP, "setup", *words, patience_s=PATIENCE_S, environ=environ)

    def wide(self, columns: int) -> list[str]:
        """Lines that are longer than a terminal of so many columns, but for those that are copied: with a path, or a
        board's frame."""
        lines = self.said.replace("\r", "").split("\n")
        return [line for line in lines if len(line) > columns and not {"/", "{"} & {*line}]


class Wiring:
    """How a robot is wired, which setup is to find out: the name of the wheel of each id, and its motor's sign."""

    def __init__(self, board: SimBoard, wheels: Mapping[int, str]) -> None:
        self._board, self.wheels = board, wheels
        board.events()

    def seen(self) -> str:
        """The answer to `which wheel turned, and which way?`: one alone has turned since the last look."""
        turned: dict[int, float] = {}
        for event in self._board.events():
            turned |= {id_: speed for id_, speed in enumerate(event.speeds) if speed and is_motion(event)}
        assert len(turned) == 1, f"not one wheel alone: {turned}"
        ((id_, speed),) = turned.items()
        name = self.wheels[id_]
        forward = (speed > 0) == (name[-1] == "+")
        return f"{name[:-1]}{'+' if forward else '-'}"

    def together(self) -> dict[str, int]:
        """Of each wheel by its name, which way it turned since the last look, as a person sees it."""
        found: dict[str, int] = {}
        for event in self._board.events():
            for id_, name in self.wheels.items():
                if speed := event.speeds[id_]:
                    found[name[:-1]] = (1 if speed > 0 else -1) * (1 if name[-1] == "+" else -1)
        return found


def is_motion(event: Event) -> bool:
    """It turns a wheel."""
    return event.is_motor and any(event.speeds)

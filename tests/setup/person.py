"""A person at a terminal of 80 columns, who answers setup by what the simulated board's wheels do."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from failstop.lab.sim.client import Event, SimBoard
from tests.support.commands import FAILSTOP
from tests.support.typist import Typist

PATIENCE_S = 90.0
"""On a machine that is busy; nothing here depends on how long it takes."""


class Person:
    """A context manager: `failstop setup` in a terminal."""

    def __init__(self, place: Path, *words: str) -> None:
        """`place`: where it keeps everything."""
        environ = {"STATE_DIRECTORY": str(place / "state"), "FAILSTOP_ROOT": str(place), "NO_COLOR": "1"}
        self.typist = Typist([*FAILSTOP, "setup", *words], columns=80, environ=environ)
        self._seen = 0
        self.answers = 0

    def __enter__(self) -> Person:
        self.typist.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self.typist.__exit__(None, None, None)

    def reads(self, text: str) -> str:
        """Wait until it says that, behind all that was read before; returns what it said until then."""
        until_s = time.monotonic() + PATIENCE_S
        while (at := self._flat().find(text, self._seen)) < 0:
            self.typist.look(0.05)
            if self.typist.process.poll() is not None and text not in self._flat()[self._seen :]:
                self.typist.look()
                assert text in self._flat()[self._seen :], f"it ended without {text!r}:\n{self.typist.raw}"
            assert time.monotonic() < until_s, f"it did not say {text!r}:\n{self.typist.raw}"
        found = self._flat()[self._seen : at + len(text)]
        self._seen = at + len(text)
        return found

    def _flat(self) -> str:
        """All that was said, its lines joined: where it is broken depends on lengths of paths."""
        return " ".join(self.typist.raw.split())

    def says(self, question: str, answer: str) -> None:
        """Answer a question once it is put."""
        self.reads(question)
        self.types(answer)

    def types(self, answer: str) -> None:
        """Type a line."""
        self.typist.type(answer.encode() + b"\n")
        self.answers += 1

    def ends(self) -> int:
        """Its exit code."""
        return self.typist.end(PATIENCE_S)

    def wide(self, columns: int) -> list[str]:
        """Lines that are longer than a terminal of so many columns, but for those with a path."""
        lines = self.typist.raw.replace("\r", "").split("\n")
        return [line for line in lines if len(line) > columns and "/" not in line]


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

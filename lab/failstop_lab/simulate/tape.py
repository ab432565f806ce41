"""Tape: everything that is drawn for a run, by labels; 0 is nothing odd, and what has no label on a tape is 0.

A run draws from a seed and writes its tape, or is played from one. So a run is the same again by its tape alone,
whatever has drawn it, and a failure keeps as few draws as it needs (shrunk).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

Draws = dict[str, int]


class Tape:
    """Of a seed, or with these draws."""

    def __init__(self, seed: int, fixed: Mapping[str, int] | None = None) -> None:
        self.fixed = fixed
        self.dice = random.Random(seed)
        """For where a draw is worth its while: nothing else may hang on it."""
        self.drawn: Draws = {}
        """All draws but zeros."""

    def draw(self, label: str, n: int, often: float = 1.0) -> int:
        """A number below `n`; `often`: for how many seeds it is more than 0."""
        if self.fixed is not None:
            value = self.fixed.get(label, 0)
            value = value if 0 <= value < n else 0
        else:
            value = self.dice.randrange(1, n) if n > 1 and self.dice.random() < often else 0
        return self.put(label, value)

    def put(self, label: str, value: int) -> int:
        """Draw this."""
        if value:
            self.drawn[label] = value
        return value


def shrunk(draws: Draws, fails: Callable[[Draws], Draws | None], most: int = 250) -> Draws:
    """The draws that a failure needs (delta debugging): parts of them are left out, in halves first and one by one at
    last. `fails`: the draws that a run with these has used, if it fails. At most `most` runs."""
    parts = 2
    while draws:
        labels, size = list(draws), -(-len(draws) // parts)
        for begin in range(0, len(labels), size):
            if most <= 0:
                return draws
            most -= 1
            left_out = set(labels[begin : begin + size])
            found = fails({label: value for label, value in draws.items() if label not in left_out})
            if found is not None:
                draws, parts = found, max(2, parts - 1)
                break
        else:
            if size == 1:
                return draws
            parts = min(len(draws), 2 * parts)
    return draws

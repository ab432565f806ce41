"""Decisions: every choice of a run, drawn under a label. 0 means that nothing odd happens, and a missing label means 0.

A run draws its decisions from a seed and records them, or is played from recorded ones. So decisions alone reproduce a
run, and a failure can be reduced to as few draws as it needs (shrunk).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

Draws = dict[str, int]


class Decisions:
    """Draws from a seed, or plays the draws in `fixed`."""

    def __init__(self, seed: int, fixed: Mapping[str, int] | None = None) -> None:
        self.fixed = fixed
        self.dice = random.Random(seed)
        """Chooses where to draw. Nothing else may depend on it."""
        self.drawn: Draws = {}
        """All draws except zeros."""

    def draw(self, label: str, n: int, often: float = 1.0) -> int:
        """A number below `n`; `often`: the probability that it is more than 0."""
        if self.fixed is not None:
            value = self.fixed.get(label, 0)
            value = value if 0 <= value < n else 0
        else:
            value = self.dice.randrange(1, n) if n > 1 and self.dice.random() < often else 0
        return self.put(label, value)

    def put(self, label: str, value: int) -> int:
        """Record this value as drawn."""
        if value:
            self.drawn[label] = value
        return value


def shrunk(draws: Draws, fails: Callable[[Draws], Draws | None], most: int = 250) -> Draws:
    """The draws that a failure needs (delta debugging): parts of them are left out, first halves and in the end single
    draws. `fails`: runs with these draws, and returns the draws that it used if it fails. At most `most` runs."""
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

"""Tape: what is drawn for one run, by a seed and the label of each draw. 0 is nothing odd.

A draw hangs on its own label alone, so that one that is taken out changes none of the others.
"""

from __future__ import annotations

import random
from collections.abc import Iterable


class Tape:
    """Of one seed. `without`: the labels whose draws are 0."""

    def __init__(self, seed: int, without: Iterable[str] = ()) -> None:
        self._seed = seed
        self._without = frozenset(without)

    def draw(self, label: str, n: int, often: float = 1.0) -> int:
        """A number below `n`; 0 but for this part of the seeds."""
        if label in self._without:
            return 0
        dice = self.dice(label)
        return dice.randrange(n) if dice.random() < often else 0

    def dice(self, label: str) -> random.Random:
        """For what is drawn once something odd is: its place and its measure."""
        return random.Random(f"{self._seed} {label}")

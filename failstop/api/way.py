"""The way of the arm: would it hit something, and when?"""

from __future__ import annotations

from math import ceil

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.capsules import Model

STEP_RAD = 0.05
"""Between two looks at the arm on its way: 5 mm at a reach of 0.1 m, 15 mm at 0.3 m."""


def on_the_way(
    model: Model, start: dict[str, float], rows: list[tuple[float, dict[str, float]]]
) -> tuple[float, str, str] | None:
    """When (s; 0 where a row has no time), and the pair that touches first, on the straight way (in angles) from
    `start` along the rows; None: none does. What touches already may part."""
    before, gap_m = (0.0, start), model.nearest(start)[0]
    for t_s, to in rows:
        row = (t_s, {**before[1], **to})
        steps = max(1, ceil(max(abs(row[1][name] - before[1].get(name, 0.0)) for name in row[1]) / STEP_RAD))
        for step in range(1, steps + 1):
            share = step / steps
            angles = {name: _between(before[1].get(name, 0.0), angle, share) for name, angle in row[1].items()}
            was_m, (gap_m, name, other) = gap_m, model.nearest(angles)
            if gap_m < min(0.0, was_m):
                return _between(before[0], row[0], share), name, other
        before = row
    return None


def _between(a: float, b: float, share: float) -> float:
    return a + share * (b - a)

"""Sparkline: the last values as a row of bars. Pure."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

BARS = "▁▂▃▄▅▆▇█"
ASCII = "_.:-=+*#"


def spark(values: Sequence[float | None], top: float, columns: int, *, fancy: bool = True) -> str:
    """The newest `columns` values, the newest at the right; `top` and above is a full bar, None a gap."""
    bars = BARS if fancy else ASCII
    shown = values[-columns:] if columns > 0 else []
    row = "".join(" " if value is None else bars[_height(value, top)] for value in shown)
    return row.rjust(columns)


def _height(value: float, top: float) -> int:
    part = min(1.0, max(0.0, value / top)) if top > 0 else 0.0
    return min(len(BARS) - 1, round(part * (len(BARS) - 1)))

"""Rows of the table: a measure, its samples, its bar.

A percentile is one of the samples, by nearest rank, so of 100 samples or fewer the p99 is the largest.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

NEAREST: Literal["inverted_cdf"] = "inverted_cdf"
"""Numpy's name of the nearest rank."""


@dataclasses.dataclass
class Row:
    """One line of the table. `met` is None where a row is there to compare with and has no bar."""

    measure: str
    result: str
    bar: str
    met: bool | None
    numbers: dict[str, Any]


def percentiles(samples_ns: list[int]) -> tuple[float, float, float]:
    """(p50, p99, max) in milliseconds."""
    if not samples_ns:
        return float("nan"), float("nan"), float("nan")
    p50, p99 = np.percentile(np.array(samples_ns) / 1e6, (50, 99), method=NEAREST)
    return float(p50), float(p99), max(samples_ns) / 1e6


def timing(measure: str, samples_ns: list[int], *, p50_ms: float | None, p99_ms: float | None) -> Row:
    """A row of percentiles with bars in milliseconds."""
    p50, p99, most = percentiles(samples_ns)
    result = f"p50 {p50:.2f}  p99 {p99:.2f}  max {most:.2f} ms of {len(samples_ns)}"
    bars, met = [], True
    if p50_ms is not None:
        bars.append(f"p50 < {p50_ms:g} ms")
        met &= p50 < p50_ms
    if p99_ms is not None:
        bars.append(f"p99 < {p99_ms:g} ms")
        met &= p99 < p99_ms
    numbers = {"p50_ms": p50, "p99_ms": p99, "max_ms": most, "samples": len(samples_ns)}
    return Row(measure, result, ", ".join(bars) or "-", met if bars else None, numbers)


def over_floor(
    measure: str, samples_ns: list[int], floor_ms: tuple[float, float, float], *, p50: float, p99: float
) -> Row:
    """A row of percentiles whose bars are multiples of a floor's own percentiles, of the same run."""
    row = timing(measure, samples_ns, p50_ms=None, p99_ms=None)
    times = [row.numbers[key] / least for key, least in zip(("p50_ms", "p99_ms"), floor_ms, strict=False)]
    row.result += f"  ({times[0]:.2f} and {times[1]:.2f} x floor)"
    row.bar = f"p50 <= {p50:g} x floor, p99 <= {p99:g} x floor"
    row.met = times[0] <= p50 and times[1] <= p99
    row.numbers |= {"floor_p50_ms": floor_ms[0], "floor_p99_ms": floor_ms[1]}
    return row


def count(measure: str, found: int, of: int) -> Row:
    """A row whose bar is zero."""
    return Row(measure, f"{found} of {of}", "0", found == 0 and of > 0, {"found": found, "of": of})


def limit(measure: str, value: float, bar: float, unit: str, detail: str = "") -> Row:
    """A row with an upper limit."""
    result = f"{value:.1f} {unit}" + (f"  ({detail})" if detail else "")
    return Row(measure, result, f"< {bar:g} {unit}", value < bar, {"value": value, "unit": unit, "detail": detail})

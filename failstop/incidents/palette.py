"""Palette: the colours of a picture, and how matplotlib draws with them."""

from __future__ import annotations

from typing import Any

INK, FAINT, GRID, PAPER = "#1b1f24", "#6b7480", "#e3e7ec", "#ffffff"
ALARM = "#c62828"
BLUE, ORANGE, GREEN, PURPLE = "#0b6fb8", "#d9822b", "#1a936f", "#8e5ea2"
BEATS = "#a9d5c3"

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.parse_math": False,
    "text.color": INK,
    "axes.edgecolor": "#b8c0c8",
    "axes.labelcolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.linewidth": 1.7,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "hatch.linewidth": 0.6,
}

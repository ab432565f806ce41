"""The tables of docs/fleet.md: its metrics and its settings."""

from __future__ import annotations

from failstop.fleet import metrics, settings

TABLES = {"metrics": metrics.markdown, "settings": settings.markdown}
"""The lines of each, by the name in the page's marks."""

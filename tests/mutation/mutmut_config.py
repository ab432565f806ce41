"""What mutmut leaves alone: lines that only a type checker reads."""

from __future__ import annotations

from typing import Any

TYPING = ("TYPE_CHECKING", "    Speeds = ", "    Four = ")


def pre_mutation(context: Any) -> None:
    """Called by mutmut before each mutant."""
    if context.current_source_line.startswith(TYPING):
        context.skip = True

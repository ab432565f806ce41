"""What mutmut leaves alone, lines that only a type checker reads, and which tests it runs for a mutant."""

from __future__ import annotations

from typing import Any

from rooms import tests_of  # type: ignore[import-not-found]  # beside this file in the copy

TYPING = ("TYPE_CHECKING", "    Speeds = ", "    Four = ", "    Entry = ", "    Value = ", "    Told = ", "    Sort = ")


def pre_mutation(context: Any) -> None:
    """Called by mutmut before each mutant."""
    if context.current_source_line.startswith(TYPING):
        context.skip = True
    context.config.test_command = f"./run-tests {tests_of(context.filename)}"

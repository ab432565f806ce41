"""Blocks: the gate's words for why the wheels may not turn, as its record and the flight recorder carry them."""

from __future__ import annotations

LATCHED = "estop: "
"""The latch's reason follows."""
DISABLED = "disabled"
NO_COMMAND = "cmd timeout"
NO_SCAN = "no scan"
BLOCK_WORDS = (LATCHED, DISABLED, NO_COMMAND, NO_SCAN)
"""Every one; the first that holds is told."""

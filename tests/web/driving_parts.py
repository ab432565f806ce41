"""A page that may drive: its settings, and how long a command of it counts."""

from __future__ import annotations

COMMAND_S, LATE_S = 0.3, 0.02
"""A command's life, and what the gate and the wire may take beyond."""
DRIVING = (
    '[attend]\nrequired = "on"\nlease_s = 1.0\n[web]\npairing = "on"\ndrive = "on"\n[sources.page]\npriority = 50\n'
)

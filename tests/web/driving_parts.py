"""A page that may drive: its settings, how long a command of it counts, and motion for who attends by it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from failstop.api.errors import Refused
from failstop_lab.trial import Trial, wait_for

COMMAND_S, LATE_S = 0.3, 0.02
"""A command's life, and what the gate and the wire may take beyond."""
DRIVING = (
    '[attend]\nrequired = "on"\nlease_s = 1.0\n[web]\npairing = "on"\ndrive = "on"\n[sources.page]\npriority = 50\n'
)


def enable_soon(trial: Trial, each: Callable[[], object] = lambda: None) -> None:
    """Enable as soon as somebody attends; `each`: done before every try."""

    def enabled() -> bool:
        each()
        with contextlib.suppress(Refused):
            trial.enable()
            return True
        return False

    wait_for("motion to be enabled", enabled)

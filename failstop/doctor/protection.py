"""The check for settings that ask for a protection which the robot's board can't give."""

from __future__ import annotations

import contextlib
import shlex

from failstop import config
from failstop.board.asking import Unknown
from failstop.doctor.look import Finding, Look, ok, warn
from failstop.policy.setting import SettingError
from failstop.supervisor.fit import unused


def protection(look: Look) -> list[Finding]:
    """Name each such setting. Empty if the settings or the board are not known."""
    path, _, problem = look.settings
    if isinstance(look.board, Unknown) or (problem and not look.state):
        return []
    given: dict[str, object] = {}
    with contextlib.suppress(SettingError):
        given = config.read(path or None)
    fix = f"failstop config --check {shlex.quote(path)}" if path else ""
    found: list[Finding] = []
    for text, remedy in unused(look.active_settings, look.board, given):
        found += warn(text, fix, remedy)
    return found or ok("the board can do what the settings ask of it")

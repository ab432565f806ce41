"""Settings for services of tests that are about something else than a process that hangs or a command that is late."""

from __future__ import annotations

TIMEOUT_S = 1.5
LEASES = f"gate.lease_s = 1.0\ngate.command_timeout_s = {TIMEOUT_S}\n"
"""Silences that a busy machine keeps (docs/troubleshooting.md: gate hangs). Goes before a file's tables."""

"""Installing failstop as a service of the machine, and taking it away again.

rows.py: what this version brings. tree.py: its Python environment as a list of files. system.py: what a system has.
plan.py: from these, the steps. do.py: the steps done, or undone.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class InstallError(FailstopError):
    """Nothing was changed, or everything was changed back; the message says why and what to do."""

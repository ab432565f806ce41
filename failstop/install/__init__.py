"""Installing failstop as a service of the machine, and taking it away again.

rows.py: what this version brings. tree.py: its Python environment as a list of files. found.py: what is
asked for, and what the machine has. plan.py (pure): from these, the steps. steps.py: what a step is. do.py: the steps
done, or undone.
"""

from __future__ import annotations

from failstop.api.errors import FailstopError


class InstallError(FailstopError):
    """Nothing was changed, or everything was changed back; the message says why and what to do."""

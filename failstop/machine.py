"""Where and with what something was measured, for every table that is printed or kept."""

from __future__ import annotations

import os
import platform
import time
from typing import Any

from failstop.version import VERSION


def facts() -> dict[str, Any]:
    """This package's version, the date, and the machine's Python, kernel, architecture and number of cores."""
    return {
        "version": VERSION,
        "date": time.strftime("%Y-%m-%d"),
        "python": platform.python_version(),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }

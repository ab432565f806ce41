"""Where the saver starts: `python -I -S start.py key=value ...`, run by the supervisor, which hands its search path
over (supervisor/starter.py)."""

from __future__ import annotations

import contextlib
import os
import sys

NICE = 15
"""Before anything else: its imports take longer than its work."""


def main() -> int:
    """Save one incident; returns the exit code."""
    with contextlib.suppress(OSError):
        os.nice(NICE)
    sys.path[:] = os.environ["FAILSTOP_PATH"].split(os.pathsep)
    from failstop.incidents import saver

    return saver.main(dict(word.split("=", 1) for word in sys.argv[1:]))


if __name__ == "__main__":
    sys.exit(main())

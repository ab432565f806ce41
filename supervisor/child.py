"""Where each process of the service starts: `python -I -S child.py PROCESS key=value ...`.

Run by the supervisor, and by `failstop run` for the supervisor itself. Without the site module, which costs more than
all of a small process's own imports; whoever starts it hands its own search path over instead.
"""

from __future__ import annotations

import os
import sys

PATH_VARIABLE = "FAILSTOP_PATH"


def main(argv: list[str]) -> int:
    """Run one process until it ends; returns its exit code."""
    sys.path[:] = os.environ[PATH_VARIABLE].split(os.pathsep)
    words = dict(word.split("=", 1) for word in argv[2:])
    if argv[1] == "supervisor":
        from failstop.supervisor import entry

        return entry.start(words)
    from failstop.policy.processes import BY_NAME
    from failstop.procs.context import Context

    row = BY_NAME[argv[1]]
    context = Context(row.name, words, row.priority, outlives_parent=row.outlives_supervisor)
    module = __import__(row.module, fromlist=["run"])
    code: int = module.run(context)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv))

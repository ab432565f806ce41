"""The script that starts every process of the service: `python -I -S bootstrap.py PROCESS key=value ...`.

The supervisor runs this script for each of its children, and `failstop run` runs it for the supervisor. The option -S
leaves out Python's site module, which in a small process takes longer than all other imports together. Python then does
not find every package, so the starting process passes its own search path in an environment variable.
"""

from __future__ import annotations

# The C module under `signal`, which costs an import of enum.
import _signal
import os
import select
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

PATH_VARIABLE = "FAILSTOP_PATH"


def main(argv: list[str]) -> int:
    """Run the process that `argv` names, until the process ends. Returns its exit code."""
    # End at once, as from any other signal. The supervisor handles SIGINT as soon as it starts processes. Before that,
    # the board has already got its stop, and nobody can drive.
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    sys.path[:] = os.environ[PATH_VARIABLE].split(os.pathsep)
    words = dict(word.split("=", 1) for word in argv[2:])
    try:
        if argv[1] == "supervisor":
            from failstop.supervisor import entry

            return entry.start(words)
        from failstop.policy.processes import PROCESS_BY_NAME
        from failstop.procs.context import Context

        row = PROCESS_BY_NAME[argv[1]]
        context = Context(row.name, words, row.priority, outlives_parent=row.outlives_supervisor)
        code: int = __import__(row.module, fromlist=["run"]).run(context)
        return code
    except Exception as error:
        fail(error)


def fail(error: Exception) -> NoReturn:
    """Print the error, with a traceback without source lines, and end this process at once. A normal exit of the
    interpreter would take 5 ms, and delay the stop by as much. Prints nothing if stderr can't accept it at once."""
    try:
        lines = ["Traceback (most recent call last):"]
        at = error.__traceback__
        while at:
            code = at.tb_frame.f_code
            lines.append(f'  File "{code.co_filename}", line {at.tb_lineno}, in {code.co_name}')
            at = at.tb_next
        text = "\n".join((*lines, f"{type(error).__name__}: {error}", ""))
        if select.select((), (2,), (), 0)[1]:
            os.write(2, text.encode("utf-8", "replace")[: select.PIPE_BUF])
    finally:
        os._exit(1)


if __name__ == "__main__":
    sys.exit(main(sys.argv))

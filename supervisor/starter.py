"""Starts and reaps processes, including the supervisor. Also decides which interpreter and which command line each
process gets.

Processes start with the options `-I -S`, so without Python's site module (bootstrap.py explains why). They get the
search path for packages in an environment variable.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence

from failstop.files import root
from failstop.policy.settings import SETTINGS_VARIABLE, Settings
from failstop.supervisor.bootstrap import PATH_VARIABLE

_PACKAGE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
BOOTSTRAP = ("supervisor", "bootstrap.py")
C_LIBRARY = {"LANG": "C.UTF-8", "MALLOC_ARENA_MAX": "1"}
"""Environment variables for the C library. With MALLOC_ARENA_MAX=1, all threads share one heap. Otherwise, a thread
that allocates memory for the first time, perhaps minutes after the start, would create a second heap of 200 kB."""
PASSED_ON = (root.VARIABLE, "XDG_RUNTIME_DIR", "STATE_DIRECTORY", "XDG_STATE_HOME", "HOME")
"""Environment variables that every process gets. They say where the runtime directory and telemetry's files are."""
TO_THE_SUPERVISOR = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")
"""Environment variables that the service manager sets. Only the supervisor gets them, because only the supervisor
notifies the service manager and sends events to the journal."""


def script_command(script: tuple[str, ...], *arguments: str, words: Mapping[str, object]) -> list[str]:
    """The command line for a script of this package. `script`: the parts of the script's path inside the package.
    `words`: further arguments, written as KEY=VALUE after `arguments`."""
    path = os.path.join(_PACKAGE, *script)
    return [sys.executable, "-I", "-S", path, *arguments, *(f"{key}={value}" for key, value in words.items())]


def environment(settings: Settings) -> dict[str, str]:
    """All environment variables of a process that the supervisor starts."""
    path = dict.fromkeys([os.path.dirname(_PACKAGE), *filter(os.path.isabs, sys.path)])
    found = {PATH_VARIABLE: os.pathsep.join(path), SETTINGS_VARIABLE: settings.lines(), **C_LIBRARY}
    return found | {name: os.environ[name] for name in PASSED_ON if name in os.environ}


def spawn(arguments: list[str], environ: Mapping[str, str], passed: Sequence[int] = ()) -> int:
    """Start a process that inherits the descriptors in `passed`. Returns the process's pid. Raises OSError."""
    for fd in passed:
        os.set_inheritable(fd, True)
    try:
        # A terminal sends its signals (Ctrl-C, Ctrl-Z, quit, hang-up) to a whole process group. If the children were
        # in that group, they would all die or freeze at once, and no process would be left to stop the wheels.
        return os.posix_spawn(arguments[0], arguments, environ, setsid=True, setsigmask=())
    finally:
        for fd in passed:
            os.set_inheritable(fd, False)


def reap(pid: int, options: int = os.WNOHANG) -> int | None:
    """Reap a child, and return its exit code. If a signal killed the child, return the negative number of the signal.
    Returns None if the child can't be reaped yet."""
    found, status = os.waitpid(pid, options)
    return os.waitstatus_to_exitcode(status) if found else None


def become_supervisor(name: str, runtime_dir: str, settings: Settings, lock: int, port: int, again: str) -> None:
    """Replace this process with the supervisor by exec. The supervisor has the same pid, and inherits the lock and the
    open port. Without the exec, the modules that the command line has imported would make it twice as large. `again`:
    the command line that starts the same service again. Raises OSError."""
    for fd in (lock, port):
        os.set_inheritable(fd, True)
    words = {"name": name, "dir": runtime_dir, "lock": lock, "port": port, "again": again}
    arguments = script_command(BOOTSTRAP, "supervisor", words=words)
    handed = {name: os.environ[name] for name in TO_THE_SUPERVISOR if name in os.environ}
    os.execve(arguments[0], arguments, environment(settings) | handed)

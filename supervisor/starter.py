"""Starting and reaping processes, the supervisor included: which interpreter, and which command line.

They start with `-I -S` and get the search path on the command line, because the site module costs a small process more
than all of its own imports.
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
"""Settings of the C library: all threads use one heap. A second heap would cost 200 kB when a thread does its first
job, minutes after the start."""
PASSED_ON = (root.VARIABLE, "XDG_RUNTIME_DIR", "STATE_DIRECTORY", "XDG_STATE_HOME", "HOME")
"""Environment variables that every process gets, because they say where the runtime directory and telemetry's files
are."""
TO_THE_SUPERVISOR = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")
"""Environment variables from the service manager. Only the supervisor notifies it, so it removes them from its
environment."""


def script_command(script: tuple[str, ...], *arguments: str, words: Mapping[str, object]) -> list[str]:
    """The command line of a script in this package, by its path in the package."""
    path = os.path.join(_PACKAGE, *script)
    return [sys.executable, "-I", "-S", path, *arguments, *(f"{key}={value}" for key, value in words.items())]


def environment(settings: Settings) -> dict[str, str]:
    """The whole environment of a process."""
    path = dict.fromkeys([os.path.dirname(_PACKAGE), *filter(os.path.isabs, sys.path)])
    found = {PATH_VARIABLE: os.pathsep.join(path), SETTINGS_VARIABLE: settings.lines(), **C_LIBRARY}
    return found | {name: os.environ[name] for name in PASSED_ON if name in os.environ}


def spawn(arguments: list[str], environ: Mapping[str, str], passed: Sequence[int] = ()) -> int:
    """Start a process that inherits the descriptors in `passed`. Returns its pid. Raises OSError."""
    for fd in passed:
        os.set_inheritable(fd, True)
    try:
        # A terminal's signals (Ctrl-C, Ctrl-Z, quit, its hang-up) go to a whole process group: were the children in
        # it, they would all die or freeze at once, with nobody left to stop the wheels.
        return os.posix_spawn(arguments[0], arguments, environ, setsid=True, setsigmask=())
    finally:
        for fd in passed:
            os.set_inheritable(fd, False)


def reap(pid: int, options: int = os.WNOHANG) -> int | None:
    """The exit code of a child that has ended, negative if a signal killed it; None if it can't be reaped yet."""
    found, status = os.waitpid(pid, options)
    return os.waitstatus_to_exitcode(status) if found else None


def become_supervisor(name: str, runtime_dir: str, settings: Settings, lock: int, port: int, again: str) -> None:
    """Replace this process by the supervisor, under the same pid. It inherits the lock and the open port. It is a new
    program, because the imports of the command line would double its size. `again`: the command line that starts this
    run again. Raises OSError."""
    for fd in (lock, port):
        os.set_inheritable(fd, True)
    words = {"name": name, "dir": runtime_dir, "lock": lock, "port": port, "again": again}
    arguments = script_command(BOOTSTRAP, "supervisor", words=words)
    handed = {name: os.environ[name] for name in TO_THE_SUPERVISOR if name in os.environ}
    os.execve(arguments[0], arguments, environment(settings) | handed)

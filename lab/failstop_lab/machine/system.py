"""System: the calls of the simulated kernel by the names that Python's own modules give them.

`modules(calls)` is what a program on the simulated machine imports instead of `os`, `time`, `select` and the others. A
call that is not simulated does not exist there, so a program that makes it fails at its first run, and asks no other
machine.
"""

from __future__ import annotations

import stat
import sys
import weakref
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NoReturn

from failstop_lab.machine.calls import Calls, Module
from failstop_lab.machine.system_devices import devices
from failstop_lab.machine.system_os import Os
from failstop_lab.machine.system_threads import threads
from failstop_lab.machine.system_waiting import Select, Time


class StandardStream:
    """Standard output or error of the process that writes, which is no terminal."""

    encoding = "utf-8"

    def __init__(self, system: Os, fd: int) -> None:
        self._system, self._fd = system, fd

    def write(self, text: str) -> int:
        self._system.write(self._fd, text.encode())
        return len(text)

    def flush(self) -> None:
        """Nothing is kept back."""

    def isatty(self) -> bool:
        return False


class Sys(Module):
    """The module `sys`: a search path and arguments of each process."""

    def __init__(self, calls: Calls, system: Os) -> None:
        plain = {name: getattr(sys, name) for name in ("version_info", "abiflags", "flags", "byteorder", "platform")}
        super().__init__("sys", calls, executable="/usr/bin/python3", **plain)
        self.stdout, self.stderr = StandardStream(system, 1), StandardStream(system, 2)

    @property
    def path(self) -> list[str]:
        return self._machine.current.process.sys_path if self._machine.current else []

    @property
    def argv(self) -> list[str]:
        return self._machine.current.process.argv if self._machine.current else ["simulation"]

    def exit(self, code: object = 0) -> NoReturn:
        raise SystemExit(code)


class Weakref(Module):
    """The module `weakref`: a process that ends here has no interpreter that would clean up behind it."""

    def __init__(self, calls: Calls) -> None:
        plain = {name: value for name, value in vars(weakref).items() if name != "finalize"}
        super().__init__("weakref", calls, **plain)
        self._own = type("finalize", (weakref.finalize,), {"_registry": {}})
        """Python's own register of them would keep the machine in memory."""

    def finalize(self, referent: Any, body: Callable[..., object], *arguments: Any) -> Any:
        made = self._own(referent, self._machine.finalizer(body), *arguments)
        made.atexit = False
        return made


class Users(Module):
    """`grp` and `pwd`: there is no group `failstop`, and users but root have numbers only."""

    def getgrnam(self, name: str) -> NoReturn:
        raise KeyError(name)

    getgrgid = getgrnam

    def getpwuid(self, uid: int) -> SimpleNamespace:
        if uid:
            raise KeyError(uid)
        return SimpleNamespace(pw_name="root")


class Collector(Module):
    """The module `gc`: it is the simulation's."""

    def collect(self) -> int:
        return 0

    def freeze(self) -> None:
        """Nothing to freeze for one process of many."""

    disable = freeze


def modules(calls: Calls) -> dict[str, Any]:
    """Modules of the simulated machine, by name."""
    system = Os(calls)
    return {
        "os": system,
        "os.path": system.path,
        "select": Select(calls),
        "time": Time(calls),
        "sys": Sys(calls, system),
        "stat": stat,
        "weakref": Weakref(calls),
        "grp": Users("grp", calls),
        "pwd": Users("pwd", calls),
        "gc": Collector("gc", calls),
        "resource": Module("resource", calls, RLIMIT_NOFILE=7, getrlimit=lambda which: (1024, 1024)),
        **threads(calls),
        **devices(calls),
    }

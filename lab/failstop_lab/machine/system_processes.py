"""The calls of the simulated `os` about processes: whose they are, how they are scheduled, their children and ends."""

from __future__ import annotations

import errno
import os
import posixpath
from collections.abc import Iterable
from typing import Any, NoReturn

from failstop_lab.machine.calls import Module
from failstop_lab.machine.process import Process, Replaced, Thread

BOOTSTRAP_FILE = "bootstrap.py"
"""The script that becomes whichever process its first word names."""


class Processes(Module):
    """The calls about processes."""

    def kill(self, pid: int, number: int) -> None:
        self._calls.process("kill", pid)
        for each in self._machine.addressed(pid):
            self._machine.kill(each, int(number))

    def waitpid(self, pid: int, options: int) -> tuple[int, int]:
        process = self._calls.process("waitpid", pid)
        child = self._machine.processes.get(pid)
        if child is None or child.reaped or child.parent is not process:
            raise ChildProcessError(errno.ECHILD, "no such child")
        while child.code is None:
            if options & os.WNOHANG:
                return 0, 0
            self._machine.block(self._machine.now_ns + 1_000_000)
        child.reaped = True
        return pid, (child.code << 8) if child.code >= 0 else -child.code

    def posix_spawn(
        self, path: str, argv: list[str], environ: Any, *, setsid: bool = False, setsigmask: Any = ()
    ) -> int:
        process = self._calls.process("spawn", argv)
        script = next((each for each in argv if each.endswith(".py")), argv[0])
        words = argv[argv.index(script) :]
        name = posixpath.basename(script)
        program = self._machine.programs.get(name)
        called = words[1] if name == BOOTSTRAP_FILE else name

        def run(child: Process) -> int:
            return program(child, words) if program else 0

        made = self._machine.process(called, run, dict(environ), process, self._machine.start_ns)
        made.argv = words
        made.group = made.pid if setsid else process.group
        self._inherit(process, made, process.inheritable)
        return made.pid

    def execve(self, path: str, argv: list[str], environ: Any) -> None:
        process = self._calls.process("execve", argv)
        process.environ = dict(environ)
        for fd in set(process.files) - process.inheritable - {0, 1, 2}:
            process.close(fd)
        raise Replaced(argv)

    @staticmethod
    def _inherit(process: Process, made: Process, fds: Iterable[int]) -> None:
        for fd in sorted({*fds, 0, 1, 2} & set(process.files)):
            made.files[fd] = process.files[fd]
            made.files[fd].references += 1
        made.inheritable = set(made.files)

    def _exit(self, code: int) -> None:
        self._machine.die(self._calls.process("exit"), code)

    def getpid(self) -> int:
        return self._machine.current.process.pid if self._machine.current else 0

    def getppid(self) -> int:
        parent = self._machine.current.process.parent if self._machine.current else None
        return parent.pid if parent else 1

    def get_terminal_size(self, fd: int = 1) -> NoReturn:
        self._calls.begin("ioctl", fd)
        raise OSError(errno.ENOTTY, "not a terminal")

    def umask(self, mask: int) -> int:
        process = self._calls.process("umask")
        before = process.umask
        process.umask = mask
        return before

    def _thread(self, number: int) -> Thread:
        found = self._machine.threads().get(number) if number else self._machine.caller()
        if found is None:
            raise ProcessLookupError(errno.ESRCH, "no such thread")
        return found

    def sched_getscheduler(self, number: int) -> int:
        return self._thread(number).scheduling[0]

    def sched_getparam(self, number: int) -> os.sched_param:
        return os.sched_param(self._thread(number).scheduling[1])

    def sched_setscheduler(self, number: int, policy: int, param: os.sched_param) -> None:
        self._calls.process("sched_setscheduler", number, policy, param.sched_priority)
        self._thread(number).scheduling = policy, param.sched_priority

    def urandom(self, most: int) -> bytes:
        return self._calls.process("urandom").random_bytes(most)

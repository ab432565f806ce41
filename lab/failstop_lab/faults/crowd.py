"""Others on the machine: forked processes that drive, ask for a stop as nobody, or keep a core busy."""

from __future__ import annotations

import atexit
import contextlib
import functools
import mmap
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from failstop.api.client import Client, send_stop
from failstop.policy.settings import FIRST_SOURCE
from failstop.version import VERSION
from failstop_lab.trial import COMMAND_EVERY_S, TrialError

NOBODY_UID = 65534
_DESCRIPTORS = 4096
GONE_S = 3.0


class Helper:
    """A forked process that runs `action` and ends; `keep` are the descriptors that it needs."""

    def __init__(self, action: Callable[[], None], keep: tuple[int, ...] = ()) -> None:
        with warnings.catch_warnings():
            # Of threads, such as a library's: the child needs none of the locks that they might hold.
            warnings.simplefilter("ignore", DeprecationWarning)
            self.pid = os.fork()
        if self.pid == 0:
            try:
                # The campaign's descriptors, its client slot above all, are not for this process to keep alive.
                low = 3
                for fd in (*sorted(keep), _DESCRIPTORS):
                    os.closerange(low, fd)
                    low = fd + 1
                action()
            finally:
                os._exit(0)

    def signal(self, number: int) -> None:
        """Send it a signal."""
        os.kill(self.pid, number)

    def end(self) -> None:
        """Kill and collect it; nothing if that has been done."""
        if self.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self.pid = 0


class _Ended(BaseException):
    """The child was told to end."""


def _fail(*_: object) -> None:
    raise ZeroDivisionError


def _end(*_: object) -> None:
    raise _Ended


class ChildDriver(Helper):
    """A program of its own that commands a velocity for as long as it lives. SIGUSR1: it fails by an exception."""

    def __init__(self, name: str, velocity: tuple[float, float, float], megabytes: int = 0) -> None:
        """`megabytes`: memory of its own that the kernel has to take down when it dies."""
        self._name = name
        self._velocity = velocity
        self._megabytes = megabytes
        self._shared = mmap.mmap(-1, 16)
        super().__init__(self._drive)

    def _drive(self) -> None:
        for number, action in ((signal.SIGHUP, signal.SIG_DFL), (signal.SIGUSR1, _fail), (signal.SIGTERM, _end)):
            signal.signal(number, action)  # all signals, whatever the campaign was started with
        _ballast = bytearray(b"x") * (self._megabytes << 20)
        client = Client(self._name, "child")
        try:
            while True:
                now = time.monotonic_ns().to_bytes(8, "little")
                client.command(*self._velocity, manual=False, source=FIRST_SOURCE)
                self._shared[:] = now + client.slot.to_bytes(8, "little")
                time.sleep(COMMAND_EVERY_S)
        except (_Ended, Exception) as error:
            client.close(in_order=isinstance(error, _Ended))

    def leave(self) -> None:
        """Have it end in order, hung or not, and collect it; nothing if it has died."""
        if self.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGTERM)
                os.kill(self.pid, signal.SIGCONT)
            os.waitpid(self.pid, 0)
            self.pid = 0

    @property
    def commanded_ns(self) -> int:
        """When it commanded last; 0: not yet."""
        return int.from_bytes(self._shared[:8], "little")

    @property
    def slot(self) -> int:
        """Its client slot."""
        return int.from_bytes(self._shared[8:], "little")


C_SOURCE = Path(__file__).resolve().parents[3] / "clients" / "c"
"""The C library, in a checkout."""


def c_unfit() -> str:
    """Why no C client can be made here; empty if it is made."""
    if not C_SOURCE.exists():
        return "the C library's source is in a checkout alone"
    if not shutil.which("cc"):
        return "no C compiler: apt install gcc libc6-dev"
    try:
        c_program()
    except TrialError as error:
        return str(error)
    return ""


@functools.cache
def c_program() -> str:
    """The C client, compiled with the library in it, once for each process; gone with it. Raises
    TrialError."""
    folder = tempfile.mkdtemp(prefix="failstop-c-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    program = os.path.join(folder, "driver")
    sources = [str(path) for path in sorted((C_SOURCE / "src").glob("*.c"))]
    places = (f"-I{C_SOURCE}/include", f"-I{C_SOURCE}/src", f'-DFS_VERSION_TEXT="{VERSION}"')
    options = ("-std=c11", "-O2", "-pthread", "-D_GNU_SOURCE", "-D_FILE_OFFSET_BITS=64", *places)
    words = ("cc", *options, "-o", program, f"{C_SOURCE}/tests/driver.c", *sources, "-lm")
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TrialError(f"the C client can't be compiled: {done.stderr.strip()}")
    return program


class CDriver:
    """A C program that commands a velocity for as long as it lives. SIGUSR1: it becomes another program."""

    def __init__(
        self, name: str, velocity: tuple[float, float, float], megabytes: int = 0, *, forks: bool = False
    ) -> None:
        """Returns at once; it drives from when it has commanded. `megabytes`: memory of its own that the kernel has to
        take down; `forks`: a child of it lives on. Raises TrialError."""
        with tempfile.NamedTemporaryFile(delete=False) as clock:
            clock.truncate(8)
            self._clock = mmap.mmap(clock.fileno(), 8)
            self._clock_path = clock.name
        self._process = subprocess.Popen(
            (c_program(), str(megabytes)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        ready = (f"open {name} 0", "connect", f"clock {clock.name}", "leave-on-term", "exec-on-usr1")
        drives = f"for -1 {' '.join(map(str, velocity))}"
        assert self._process.stdin
        self._process.stdin.write("".join(f"{line}\n" for line in (*ready, *("fork",) * forks, drives)))
        self._process.stdin.flush()

    def signal(self, number: int) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    @property
    def commanded_ns(self) -> int:
        """When it commanded last; 0: not yet."""
        return int.from_bytes(self._clock[:8], "little")

    def leave(self) -> None:
        """Have it end in order, hung or not, and collect it and its child."""
        for number in (signal.SIGTERM, signal.SIGCONT):
            self._process.send_signal(number)
        try:
            self._process.wait(GONE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdin
        assert self._process.stdout
        os.set_blocking(self._process.stdout.fileno(), False)  # a child that lives on has its end too
        if found := re.search(r"child (\d+)", self._process.stdout.read() or ""):
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(found[1]), signal.SIGKILL)
        self._process.stdout.close()
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._clock_path)


class Nobody(Helper):
    """A process without rights that asks for a stop whenever it is told to."""

    def __init__(self, name: str, reason: str) -> None:
        self._name = name
        self._reason = reason
        self._asked, ask = os.pipe()
        told, self._tell = os.pipe()
        super().__init__(self._serve, (self._asked, self._tell))
        os.close(self._asked)
        os.close(self._tell)
        self._ask, self._told = ask, told

    def _serve(self) -> None:
        if os.getuid() == 0:
            os.setgroups([])
            os.setresgid(NOBODY_UID, NOBODY_UID, NOBODY_UID)
            os.setresuid(NOBODY_UID, NOBODY_UID, NOBODY_UID)
        while os.read(self._asked, 1):
            now_ns = time.monotonic_ns()
            send_stop(self._name, self._reason)
            os.write(self._tell, now_ns.to_bytes(8, "little"))

    def ask(self) -> int:
        """Ask now; returns the time just before, CLOCK_MONOTONIC ns."""
        os.write(self._ask, b"x")
        return int.from_bytes(os.read(self._told, 8), "little")

    def end(self) -> None:
        """Kill and collect it."""
        if self.pid:
            os.close(self._ask)
            os.close(self._told)
        super().end()


def spin_for_ever() -> None:
    """Keep a core busy, at ordinary priority."""
    while True:
        pass

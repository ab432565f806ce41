"""The C library as the tests use it: built once, in the checkout, and a C program that does what it is told."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import os
import select
import shutil
import signal
import subprocess
from pathlib import Path
from types import TracebackType

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "clients" / "c"
BUILD = ROOT / "build" / "c"
WARNINGS = ("-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror")
LACKING = "the C library is not tried: apt install gcc libc6-dev make"


def compiler() -> str:
    """The C compiler; without one, the test is skipped and says so."""
    found = shutil.which("cc") or shutil.which("gcc")
    if not found or not shutil.which("make"):
        pytest.skip(LACKING)
    return found


def cpp_compiler() -> str:
    """The C++ compiler; without one, the test is skipped and says so."""
    compiler()
    found = shutil.which("c++") or shutil.which("g++")
    if not found:
        pytest.skip("C++ is not tried: apt install g++")
    return found


@functools.cache
def library() -> Path:
    """The folder of the built library. Several test processes build it one after the other."""
    compiler()
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run(
            ("make", "--silent", "-C", SOURCE, f"BUILD={BUILD}", "all", "tested"),
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    return BUILD


def compiled(source: Path, to: Path, *options: str) -> Path:
    """A C program that is linked with the library."""
    where = library()
    command = (compiler(), *WARNINGS, f"-I{SOURCE / 'include'}", *options, "-o", str(to), str(source))
    linked = (f"-L{where}", "-lfailstop", f"-Wl,-rpath,{where}", "-lm", "-pthread")
    done = subprocess.run((*command, *linked), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return to


@functools.cache
def driver() -> Path:
    """The program of clients/c/tests/driver.c."""
    return compiled(SOURCE / "tests" / "driver.c", library() / f"driver-{os.getpid()}")


@functools.cache
def whole_library() -> ctypes.CDLL:
    """The library with its internal functions, in this process."""
    return ctypes.CDLL(str(library() / "libfailstop-tested.so"))


class Driver:
    """A running C client; each command is a line, and so is each answer."""

    def __init__(
        self, megabytes: int = 0, command: tuple[str, ...] = (), environment: dict[str, str] | None = None
    ) -> None:
        """`megabytes`: memory that the kernel has to free when it dies; `command`: another program than driver()."""
        self.process = subprocess.Popen(
            (*(command or (str(driver()),)), str(megabytes)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            env={**os.environ, **(environment or {})},
            # Tests that were started by nohup hand down that it is ignored.
            preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
        )
        self.pid = self.process.pid

    def __enter__(self) -> Driver:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()

    def tell(self, line: str) -> None:
        assert self.process.stdin
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def answer(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline().rstrip("\n")

    def answer_within(self, seconds: float) -> str:
        """As answer(); empty if it takes longer."""
        assert self.process.stdout
        return self.answer() if select.select([self.process.stdout], [], [], seconds)[0] else ""

    def ask(self, line: str) -> str:
        """The whole answer to a command."""
        self.tell(line)
        return self.answer()

    def do(self, line: str) -> int:
        """The result of a command (fs_result)."""
        return int(self.ask(line).split()[0])

    def text(self, line: str) -> str:
        """The text that a command answers."""
        return self.ask(line).partition(" ")[2]

    def state(self) -> dict[str, float]:
        """The state, by the names of fs_state; `result` is what the call returned."""
        result, *fields = self.ask("state").split()
        return {"result": float(result)} | {
            name: float(value) for name, value in (field.split("=") for field in fields)
        }

    def connect(self, name: str) -> None:
        assert self.do(f"open {name} 0") == 0, self.text("error")
        assert self.do("connect") == 0, self.text("error")

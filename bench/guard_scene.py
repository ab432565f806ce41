"""A service on a simulated board with a guard port, and drivers that know nothing of failstop."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from failstop import helpers
from failstop_lab.boards.traits import traits_of
from failstop_lab.trial import Trial, TrialError, wait_for, write_settings

LINE_S = 10.0


def compiled(folder: Path, name: str) -> str:
    """Compile a program of this folder. Raises TrialError without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise TrialError("a driver in C needs a C compiler")
    made = folder / name
    source = Path(__file__).with_name(f"{name}.c")
    subprocess.run([compiler, "-O1", "-Wall", "-o", str(made), str(source)], check=True)
    return str(made)


def diffdrive(folder: Path) -> str:
    """Compile the driver that makes diffdrive_arduino's calls (diffdrive.c). Raises TrialError without a compiler."""
    return compiled(folder, "diffdrive")


class Process:
    """A program whose lines are read."""

    def __init__(self, *command: str, errors: bool = False) -> None:
        self.child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if errors else None,
            bufsize=0,
        )
        self._text = b""
        self.lines: list[str] = []

    @property
    def pid(self) -> int:
        return self.child.pid

    def line(self, timeout_s: float = LINE_S) -> str:
        """Its next line."""
        until_s = time.monotonic() + timeout_s
        assert self.child.stdout
        while b"\n" not in self._text:
            left_s = until_s - time.monotonic()
            if left_s <= 0 or not select.select([self.child.stdout], [], [], left_s)[0]:
                raise TrialError(f"no line within {timeout_s} s; before: {self.lines[-10:]}")
            part = os.read(self.child.stdout.fileno(), 65536)
            if not part:
                raise TrialError(f"it ended with {self.child.wait()}; before: {self.lines[-10:]}")
            self._text += part
        line, _, self._text = self._text.partition(b"\n")
        self.lines.append(line.decode())
        return self.lines[-1]

    def until(self, words: str, timeout_s: float = LINE_S) -> str:
        """Its next line that has these words."""
        until_s = time.monotonic() + timeout_s
        while words not in (line := self.line(max(0.0, until_s - time.monotonic()))):
            pass
        return line

    def drain(self) -> None:
        """Take the lines that wait: a pipe that is full would hold the program up."""
        assert self.child.stdout
        while b"\n" in self._text or select.select([self.child.stdout], [], [], 0)[0]:
            try:
                self.line()
            except TrialError:
                return  # it has ended

    def newest(self) -> str:
        """The next line that comes after those that wait."""
        while True:
            line = self.line()
            assert self.child.stdout
            if b"\n" not in self._text and not select.select([self.child.stdout], [], [], 0)[0]:
                return line

    def kill(self) -> None:
        self.child.kill()
        self.child.wait()

    def close(self) -> None:
        if self.child.poll() is None:
            self.kill()
        if self.child.stdout:
            self.child.stdout.close()


class GuardScene:
    """The service, its board, and a guard. Every time is taken on the board's side of the wire."""

    def __init__(self, folder: Path, kind: str, **settings: object) -> None:
        path = folder / "settings.toml"
        # No obstacle sensor is part of these tests.
        write_settings(str(path), {**traits_of(kind).settings, "scan.gate": "off", **settings})
        self.folder, self.kind = folder, kind
        self.path = str(folder / "port")
        self.trial = Trial(f"guard-{os.getpid()}-{folder.name[-12:]}".lower(), ("--config", str(path)), kind=kind)
        self._drivers: list[Process] = []
        self.guard: Process | None = None

    def __enter__(self) -> GuardScene:
        self.trial.__enter__()
        self.start_guard()
        return self

    def start_guard(self, *before: str) -> Process:
        """Start it, or start it again; `before`: a command that runs it, such as one that puts it into a container."""
        if self.guard:
            self.guard.close()
        guard = helpers.python("failstop", "guard", "--name", self.trial.name, "--path", self.path)
        self.guard = Process(*before, *guard, errors=True)
        self.guard.until("your driver opens")
        return self.guard

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end_drivers()
        if self.guard:
            self.guard.close()
        self.trial.__exit__(kind, error, at)

    def driver(self, *command: str) -> Process:
        """Start a driver."""
        self._drivers.append(Process(*command))
        return self._drivers[-1]

    def python(self, source: str, *words: str) -> Process:
        """Start a driver that is a Python program, with the port's path as its first word."""
        path = self.folder / f"driver{len(self._drivers)}.py"
        path.write_text(source)
        return self.driver(sys.executable, str(path), self.path, *words)

    def end_drivers(self) -> None:
        for driver in self._drivers:
            driver.close()
        self._drivers.clear()

    def enable(self) -> None:
        """Before a driver starts: one that commands already would have to let go first."""
        self.trial.enable()

    def rest(self) -> None:
        """Wait until nobody is at the port any more, and the wheels stand."""
        self.stands()
        if self.guard:
            self.guard.drain()
        wait_for("nobody at the port", lambda: set(self.clients()) <= {"trial", "failstop guard"})

    def moves(self) -> None:
        """Wait until the wheels turn, by the board's word. Raises TrialError, which says why they don't."""
        try:
            wait_for("the wheels to turn", self.trial.turning)
        except TrialError as error:
            if self.guard:
                self.guard.drain()
            said = self.guard.lines[-5:] if self.guard else "nothing"
            raise TrialError(f"{error}: {self.trial.robot.why()}; the guard said {said}") from None

    def stands(self) -> None:
        wait_for("the wheels to stand", lambda: not self.trial.turning())

    def clients(self) -> dict[str, int]:
        """The programs that the service knows, by name with the pid."""
        return {client.name: client.pid for client in self.trial.robot.state.clients}

    def motion(self) -> list[tuple[int, tuple[float, ...]]]:
        """When the board carried out which speeds other than zero since the last call."""
        events = self.trial.board.events()
        return [(event.executed_ns, event.speeds) for event in events if any(event.speeds)]

    def last_motion_ns(self) -> int:
        """When the board carried out the first zero after its last motion."""
        events = self.trial.board.events()
        turning = [at for at, event in enumerate(events) if any(event.speeds)]
        if not turning:
            return 0
        after = events[turning[-1] + 1 :]
        assert after, "the wheels still turn"
        return after[0].executed_ns

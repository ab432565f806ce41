"""A session of a reader at a terminal: one bash, and what stays in the foreground of other terminals."""

from __future__ import annotations

import os
import re
import select
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.files import instance
from tests.support.pages import ROOT

COMMAND_S = 60.0
READY_S = 15.0
SERVICE = "failstop"
BOARD = "/tmp/board"
ANYTHING = re.compile(r"(?<![.])[.]{3}(?![.])")
NUMBER = re.compile(r"(?:less than )?[-+]?\d[\d.:]*(?: (?:us|ms|s)\b)?")


class Session:
    """A context manager. What the pages call `failstop` and /tmp/board is this session's own here."""

    def __init__(self, name: str, directory: Path) -> None:
        self.name = name
        self._directory = directory
        self.board = str(directory / "board")
        shim = directory / "bin" / "failstop"
        shim.parent.mkdir()
        python, script = shlex.quote(sys.executable), shlex.quote(str(Path(__file__).with_name("shim.py")))
        shim.write_text(f'#!/bin/sh\nexec {python} {script} {name} "$@"\n')
        shim.chmod(0o755)
        (directory / "examples").symlink_to(ROOT / "examples")
        self._environment = {
            **os.environ,
            "PATH": f"{shim.parent}:{os.path.dirname(sys.executable)}:{os.environ['PATH']}",
            "PYTHONPATH": f"{ROOT}:{ROOT / 'lab'}",
            "XDG_STATE_HOME": str(directory / "state"),
            "NO_COLOR": "1",
            "COLUMNS": "100",
        }
        self._runtime_directory = ""
        self._terminals: list[tuple[subprocess.Popen[bytes], Path, str]] = []
        self._bash = subprocess.Popen(
            ["bash", "--norc", "-s"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=directory,
            env=self._environment,
        )

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        assert self._bash.stdin is not None
        assert self._bash.stdout is not None
        self._bash.stdin.close()
        self._bash.wait(10)
        self._bash.stdout.close()
        for process, _, _ in reversed(self._terminals):
            process.send_signal(signal.SIGTERM)
            process.wait(10)
        if self._runtime_directory:
            shutil.rmtree(self._runtime_directory, ignore_errors=True)

    def run(self, command: str) -> tuple[str, int]:
        """The output of the command, as a reader would see it, and its exit code."""
        assert self._bash.stdin is not None
        assert self._bash.stdout is not None
        end = f"<<end {time.monotonic_ns()}>>"
        self._bash.stdin.write(f"{self._own(command)}\necho; echo '{end}' $?\n".encode())
        self._bash.stdin.flush()
        seen, until_s = b"", time.monotonic() + COMMAND_S
        while f"\n{end} ".encode() not in seen or not seen.endswith(b"\n"):
            left_s = until_s - time.monotonic()
            assert left_s > 0, f"{command}: no end after {COMMAND_S:g} s: {seen!r}"
            if select.select((self._bash.stdout,), (), (), left_s)[0]:
                data = os.read(self._bash.stdout.fileno(), 65536)
                assert data, f"{command}: the shell ended: {seen!r}"
                seen += data
        text, _, code = seen.decode().rpartition(f"\n{end} ")
        return self._shown(text), int(code)

    def stay(self, command: str) -> None:
        """Start a command in a terminal of its own; wait until the board or the service is there, or the program has
        said something."""
        output = self._directory / f"terminal-{len(self._terminals)}"
        with output.open("wb") as file:
            process = subprocess.Popen(
                ["bash", "--norc", "-c", f"exec {self._own(command)}"],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                cwd=self._directory,
                env=self._environment,
            )
        self._terminals.append((process, output, command))
        until_s = time.monotonic() + READY_S
        while not self._up(command, output):
            assert process.poll() is None, output.read_text()
            assert time.monotonic() < until_s, output.read_text()
            time.sleep(0.01)

    def stay_again(self, command: str) -> None:
        """Press Ctrl-C in the terminal of the same command, and start it there once more, with other options."""
        words = command.split()[:2]
        process = next(process for process, _, started in reversed(self._terminals) if started.split()[:2] == words)
        process.send_signal(signal.SIGINT)
        process.wait(10)
        self.stay(command)

    def _up(self, command: str, output: Path) -> bool:
        if " sim " in command:
            return os.path.exists(self.board)
        if " guard " in command:
            return "your driver opens" in output.read_text()
        if not command.startswith("failstop "):
            return output.stat().st_size > 0
        try:
            with Robot(self.name) as robot:
                self._runtime_directory = instance.find(self.name)
                return robot.state.waiting_for is None
        except FailstopError:
            return False

    def said(self, index: int) -> str:
        """The text that the terminal of that number shows by now."""
        return self._shown(self._terminals[index][1].read_text())

    def python(self, code: str) -> str:
        """Run a program; what it printed."""
        result = subprocess.run(
            [sys.executable, "-c", self._of_this(code)],
            capture_output=True,
            text=True,
            timeout=COMMAND_S,
            env=self._environment,
        )
        assert result.returncode == 0, result.stderr
        return self._shown(result.stdout)

    def save(self, name: str, text: str) -> None:
        """Save a file of that name as a reader does: settings, or a program."""
        (self._directory / name).write_text(self._of_this(text))

    def _of_this(self, code: str) -> str:
        return code.replace("Robot()", f'Robot("{self.name}")').replace(".connect()", f'.connect("{self.name}")')

    def _own(self, command: str) -> str:
        return command.replace(BOARD, self.board)

    def _shown(self, text: str) -> str:
        return text.replace(self.board, BOARD).replace(self.name, SERVICE)


def differs(shown: list[str], printed: str) -> str:
    """The text of the page and the text that was printed, if they differ; else an empty text. Where lines are broken
    does not count, nor which number stands somewhere, nor whether it is in us, ms or s. Three dots are anything; more
    than three are just dots."""
    pattern = ".*".join(re.escape(part.strip()) for part in ANYTHING.split(_plain("\n".join(shown))))
    found = _plain(printed)
    return "" if re.fullmatch(pattern, found) else f"the page shows\n  {_plain(chr(10).join(shown))}\nit was\n  {found}"


def _plain(text: str) -> str:
    text = re.sub(r"\s+", " ", text).strip()
    text = re.sub(rf" --name {SERVICE}\b", "", text)
    return NUMBER.sub("0", text)

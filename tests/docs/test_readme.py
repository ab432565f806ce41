"""The README as a stranger reads it: its blocks typed one after the other into a fresh shell, in a fresh copy."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop_lab.trial import Trial, wait_for
from tests.support.pages import ROOT, blocks

from .session import differs

README = ROOT / "README.md"
BLOCK_S = 120.0
READY_S = 20.0
FAILED = ("command not found", "not found", "Traceback", "refused:", "No such file", "usage:")
BY_ROOT = "sudo"
SHELLS = ("/bin/bash --norc --noprofile -i", "/bin/dash -i")
PROGRAM = next(block.text for block in blocks(README) if block.language == "python")


class Shell:
    """A shell at a terminal, with nothing of this environment's on its path."""

    def __init__(self, command: str, folder: Path, environment: dict[str, str]) -> None:
        words = command.split()
        self._pid, self._terminal = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            os.execve(words[0], words, environment)
        self._seen = b""
        self._pastes = 0

    def paste(self, text: str) -> str:
        """Paste a block, and return what the terminal showed until the shell had run all of it."""
        start, self._pastes = len(self._seen), self._pastes + 1
        # What is looked for is not what the terminal echoes.
        os.write(self._terminal, f"{text}\necho '<end' {self._pastes}'>'\n".encode())
        return self.wait(f"<end {self._pastes}>", start, BLOCK_S)

    def wait(self, words: str, start: int = 0, seconds: float = READY_S) -> str:
        """Wait until the terminal shows these words, and return what it has shown from there."""
        until_s = time.monotonic() + seconds
        while words.encode() not in self._seen[start:]:
            assert time.monotonic() < until_s, self._seen[start:].decode(errors="replace")
            self._read(0.1)
        return self._seen[start:].decode(errors="replace")

    def _read(self, longest_s: float) -> None:
        if select.select((self._terminal,), (), (), longest_s)[0]:
            self._seen += os.read(self._terminal, 65536)

    def end(self) -> None:
        """End it, and what was started in it and is still there."""
        os.write(self._terminal, b"kill %2; kill %1; exit\nexit\n")
        until_s = time.monotonic() + 20.0
        with contextlib.suppress(OSError):
            while time.monotonic() < until_s:
                self._read(0.1)
        os.close(self._terminal)
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The files of the repository, where `make` finds failstop installed: no index is asked."""
    folder = tmp_path / "failstop"
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    environment = folder / ".venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    [packages] = environment.glob("lib/python*/site-packages")
    (packages / "test.pth").write_text(f"{folder}\n{folder / 'lab'}\n{sysconfig.get_path('purelib')}\n")
    script = environment / "bin" / "failstop"
    script.write_text(f"#!{environment}/bin/python\nfrom failstop.cli.main import main\nraise SystemExit(main())\n")
    script.chmod(0o755)
    (environment / ".installed").touch()
    return folder


@pytest.fixture(params=SHELLS, ids=lambda command: Path(command.split()[0]).name)
def shell(request: pytest.FixtureRequest, copy: Path, tmp_path: Path) -> Iterator[Shell]:
    """Fresh, and apart from what else runs on this machine."""
    if not os.path.exists(request.param.split()[0]):
        pytest.skip("no such shell here")
    for name in ("home", "run", "root"):
        (tmp_path / name).mkdir(mode=0o700)
    environment = {
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "HOME": str(tmp_path / "home"),
        "TERM": "xterm",
        "NO_COLOR": "1",
        "TMPDIR": os.environ.get("TMPDIR", "/tmp"),
        "XDG_RUNTIME_DIR": str(tmp_path / "run"),
        "FAILSTOP_ROOT": str(tmp_path / "root"),
    }
    (tmp_path / "root" / "run").mkdir()
    made = Shell(request.param, copy, environment)
    yield made
    made.end()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_its_blocks_work_typed_one_after_the_other_into_a_fresh_shell(shell: Shell, copy: Path, tmp_path: Path) -> None:
    found = blocks(README)
    [demo] = [block for block in found if block.language == "console"]
    start, drive = [block.text for block in found if block.language == "sh" and BY_ROOT not in block.text]
    [(command, shown)] = demo.steps()
    shell.paste(f"{command} > demo.txt 2>&1")
    assert not (wrong := differs(shown, (copy / "demo.txt").read_text())), wrong

    seen = shell.paste(start.replace("/tmp/board", str(tmp_path / "board")).rstrip())
    assert "not found" not in seen
    shell.wait("' is ready: ")
    (copy / "patrol.py").write_text(PROGRAM)
    driven = shell.paste(drive.rstrip())
    assert not [words for words in FAILED if words in driven], driven
    for words in ("motion enabled", "stop latched", "hand near wheel", "latched stop cleared"):
        assert words in driven
    shell.wait("do     ")  # the last words of patrol.py, which says why it was stopped

    [end] = re.findall(r"end the service before the board: `([^`]+)`", README.read_text())
    assert "POWER SWITCH" not in shell.paste(end)
    shell.wait("stopped; the stop was written twice")


def test_its_program_moves_nothing_by_itself_when_it_is_restarted(trial: Trial, tmp_path: Path) -> None:
    """As Restart=always does it: only a person's enable lets it drive."""
    program = tmp_path / "patrol.py"
    program.write_text(PROGRAM.replace("Robot()", f'Robot("{trial.name}")'))

    def started() -> subprocess.Popen[bytes]:
        running = subprocess.Popen([sys.executable, str(program)], stdout=subprocess.DEVNULL)
        wait_for("the program to wait", lambda: waits(running.pid))
        return running

    trial.enable()
    trial.robot.disable()
    running = started()
    trial.robot.enable()
    wait_for("the program to drive", trial.turning)
    for _ in range(3):
        running.kill()
        running.wait()
        wait_for("the wheels to stop", lambda: not trial.turning())
        trial.board.events()
        running = started()
        time.sleep(0.5)
        assert not [event for event in trial.board.events() if event.is_motion]
        assert not trial.robot.state.enabled
    running.kill()
    running.wait()


def waits(pid: int) -> bool:
    """Whether the process reads the shared memory of a run by now."""
    with contextlib.suppress(FileNotFoundError):
        return "/dev/shm/" in Path(f"/proc/{pid}/maps").read_text()
    return False


def test_what_it_does_for_people_comes_before_the_picture_of_processes() -> None:
    shown = re.findall(r"\(docs/pictures/(.*?)\)", README.read_text())
    assert shown == ["crash.svg", "probe.svg", "where.svg"]


@pytest.mark.parametrize("word", ["floor", "bar"])
def test_it_has_no_word_of_a_reviewer_s(word: str) -> None:
    assert not re.search(rf"\b{word}\b", README.read_text())

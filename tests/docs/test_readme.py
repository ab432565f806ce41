"""The README as a stranger reads it: its blocks pasted one after the other into a fresh shell, in a fresh copy."""

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

from tests.support.pages import ROOT, blocks

README = ROOT / "README.md"
BLOCK_S = 120.0
FAILED = ("command not found", "Traceback", "refused:", "No such file", "usage:")
BY_ROOT = "sudo"


class Shell:
    """A bash at a terminal, with nothing of this environment's on its path."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._pid, self._terminal = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            os.execve("/bin/bash", ["bash", "--norc", "--noprofile", "-i"], environment)
        self._seen = b""

    def paste(self, text: str, number: int) -> str:
        """Paste a block, and return what the terminal showed until the shell had run all of it."""
        start = len(self._seen)
        end = f"<end {number}>"
        # What is looked for is not what the terminal echoes.
        os.write(self._terminal, f"{text}\necho '<end' {number}'>'\n".encode())
        until_s = time.monotonic() + BLOCK_S
        while end.encode() not in self._seen[start:]:
            assert time.monotonic() < until_s, self._seen[start:].decode(errors="replace")
            self._read(0.1)
        return self._seen[start:].decode(errors="replace")

    def _read(self, longest_s: float) -> None:
        if select.select((self._terminal,), (), (), longest_s)[0]:
            self._seen += os.read(self._terminal, 65536)

    def end(self) -> None:
        """End what was started in it, and itself."""
        os.write(self._terminal, b"kill %1 %2; wait; exit\n")
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


@pytest.fixture
def shell(copy: Path, tmp_path: Path) -> Iterator[Shell]:
    """Fresh, and apart from what else runs on this machine."""
    for name in ("home", "run", "root"):
        (tmp_path / name).mkdir(mode=0o700)
    environment = {
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "HOME": str(tmp_path / "home"),
        "TERM": "xterm",
        "TMPDIR": os.environ.get("TMPDIR", "/tmp"),
        "XDG_RUNTIME_DIR": str(tmp_path / "run"),
        "FAILSTOP_ROOT": str(tmp_path / "root"),
    }
    (tmp_path / "root" / "run").mkdir()
    made = Shell(copy, environment)
    yield made
    made.end()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_its_blocks_work_pasted_one_after_the_other_into_a_fresh_shell(shell: Shell, tmp_path: Path) -> None:
    pasted = [block.text for block in blocks(README) if block.language == "sh" and BY_ROOT not in block.text]
    assert len(pasted) == 3
    board = str(tmp_path / "board")
    seen = [shell.paste(text.replace("/tmp/board", board).rstrip(), number) for number, text in enumerate(pasted)]
    start, drive, program = seen
    for shown in (drive, program):
        assert not [words for words in FAILED if words in shown], shown
    assert "command not found" not in start
    assert "motion enabled" in start
    assert "drove for 2 s" in drive
    assert "hand near wheel" in drive
    assert shell.paste("sleep 1; failstop status", 9).count("STOPPED") == 1, "seen still by then"


def test_a_person_s_pictures_come_before_the_picture_of_processes() -> None:
    shown = re.findall(r"\(docs/pictures/(.*?)\)", README.read_text())
    assert shown.index("where.svg") > max(shown.index("operator-phone.png"), shown.index("hung-gate.png"))


@pytest.mark.parametrize("word", ["floor", "bar"])
def test_it_has_no_word_of_a_reviewer_s(word: str) -> None:
    assert not re.search(rf"\b{word}\b", README.read_text())

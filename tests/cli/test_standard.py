"""Programs started with standard input, output or error closed: no file that they open takes its place."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import combinations, product
from pathlib import Path

import pytest

from tests.support.commands import FAILSTOP
from tests.support.terminal import Terminal

CLOSE = "import os, sys; [os.close(int(n)) for n in sys.argv[1].split(',')]; os.execv(sys.argv[2], sys.argv[2:])"
LOOK = """
import json, os, sys
from failstop.cli import standard
standard.fill()
opened = os.open(sys.argv[1], os.O_WRONLY)
sys.stdout.write("for nobody\\n")
sys.stderr.write("for nobody\\n")
sys.stdout.flush()
three = [os.path.realpath(f"/proc/self/fd/{fd}") for fd in range(3)]
kept = [os.get_inheritable(fd) for fd in range(3)]
os.write(opened, json.dumps([opened, three, kept]).encode())
"""
CLOSED = [which for number in (1, 2, 3) for which in combinations((0, 1, 2), number)]


def run_without(closed: tuple[int, ...], *command: str) -> int:
    words = [sys.executable, "-c", CLOSE, ",".join(map(str, closed)), sys.executable, *command]
    return subprocess.run(words, stdin=subprocess.PIPE, capture_output=True, timeout=60, check=False).returncode


@pytest.mark.parametrize("closed", CLOSED, ids=str)
def test_what_is_closed_is_dev_null_and_what_is_open_stays(closed: tuple[int, ...], tmp_path: Path) -> None:
    report = tmp_path / "report"
    report.touch()
    assert run_without(closed, "-c", LOOK, str(report)) == 0
    opened, three, inheritable = json.loads(report.read_text())
    assert opened > 2
    assert [fd for fd in range(3) if three[fd] == os.devnull] == list(closed)
    assert inheritable == [True] * 3, "the supervisor, which follows by exec, has them too"


def test_a_command_that_has_nobody_to_talk_to_still_answers_by_its_code() -> None:
    assert run_without((1, 2), "-m", "failstop", "status", "--name", "nobody-runs-this") == 3


@pytest.mark.parametrize(
    ("words", "buffered"),
    [
        *product(["--version", "config --example"], [True, False]),
        ("--help", False),
        ("config", False),
        ("drive --help", True),  # what argparse writes at once, and can't, it keeps to itself
    ],
)
def test_output_that_nothing_takes_is_told_in_one_line(words: str, buffered: bool) -> None:
    environ = {**os.environ, "PYTHONUNBUFFERED": "" if buffered else "1"}
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "failstop", *words.split()]
        to = {"stdout": full, "stderr": subprocess.PIPE}
        done = subprocess.run(command, **to, env=environ, text=True, timeout=60, check=False)  # type: ignore[call-overload]
    assert done.returncode == 1
    assert done.stderr == (
        "failstop: standard output can't be written (No space left on device), so the output above is incomplete\n"
    )


def test_a_reader_that_has_gone_is_told_nothing() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "failstop", "--help"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_refusal_keeps_its_code_when_nobody_can_be_told() -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "failstop", "status", "--name", "nobody-runs-this"]
        assert subprocess.run(command, stdout=full, stderr=full, timeout=60, check=False).returncode == 3


def test_bytes_that_are_no_text_are_a_wrong_answer() -> None:
    read = "from failstop.cli import standard; standard.accept_any_bytes(); print(ascii(input()))"
    environ = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; {read}"], input=b"\xe9s\n", env=environ, capture_output=True, check=False
    )
    assert done.stdout == b"'\\ufffds'\n"


def test_bytes_that_are_no_text_end_no_question_of_setup(tmp_path: Path) -> None:
    environ = {"STATE_DIRECTORY": str(tmp_path), "PYTHONIOENCODING": "utf-8:strict"}
    with Terminal(*FAILSTOP, "setup", patience_s=60.0, environ=environ) as person:
        person.reads("Which port is the board at?")
        person.presses(b"/dev/tty\xe9\n")
        person.reads("does not exist: plug the board in, or type another path")

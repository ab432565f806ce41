"""Completion: bash is asked for real, zsh and fish where they are installed."""

from __future__ import annotations

import argparse
import os
import pty
import select
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from failstop.cli import main as cli
from failstop_lab.pages import completion

ASK = """\
source "$1"; shift
compopt() { :; }
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
_failstop
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture(scope="module")
def bash_script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("completion") / "failstop.bash"
    file.write_text(completion.script("bash"))
    return file


def asked(script: Path, *words: str, cwd: Path | None = None) -> set[str]:
    """Words that bash offers for the last of those given."""
    result = subprocess.run(
        ["bash", "--norc", "-c", ASK, "ask", str(script), *words],
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
        cwd=cwd,
    )
    assert result.stderr == ""
    return set(result.stdout.split("\n")) - {""}


def every_command() -> list[argparse.ArgumentParser]:
    return [parser for parser in completion.walk(completion.whole()) if parser.prog != "failstop"]


def flags(parser: argparse.ArgumentParser) -> set[str]:
    return {"-h", "--help"} | {flag for action in completion.arguments(parser) for flag in action.option_strings}


def test_bash_offers_every_command(bash_script: Path) -> None:
    assert asked(bash_script, "failstop", "") == {*cli.COMMANDS, "help"}
    assert asked(bash_script, "failstop", "dr") == {"drive"}
    assert asked(bash_script, "failstop", "help", "ena") == {"enable"}
    assert asked(bash_script, "failstop", "--v") == {"--version"}


def test_bash_offers_every_option_and_choice(bash_script: Path) -> None:
    lines: list[list[str]] = []
    expected = []
    for parser in every_command():
        lines.append([*parser.prog.split(), "--"])
        expected.append({flag for flag in flags(parser) if flag.startswith("--")})
        for action in completion.arguments(parser):
            if action.option_strings and action.choices:
                lines.append([*parser.prog.split(), action.option_strings[-1], ""])
                expected.append(set(map(str, action.choices)))
    questions = "\n".join(
        f"COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _failstop; echo ${{COMPREPLY[*]}}"
        for words in lines
    )
    result = subprocess.run(
        ["bash", "--norc"], input=f"source {bash_script}\n{questions}\n", capture_output=True, text=True, timeout=60
    )
    assert result.stderr == ""
    assert [set(line.split()) for line in result.stdout.splitlines()] == expected
    assert len(lines) > len(cli.COMMANDS)


def test_bash_knows_what_stands_where(bash_script: Path, tmp_path: Path) -> None:
    (tmp_path / "my robot.toml").touch()
    (tmp_path / "folder").mkdir()
    here = {"my robot.toml", "folder"}
    assert asked(bash_script, "failstop", "run", "--config", "", cwd=tmp_path) == here
    assert asked(bash_script, "failstop", "run", "--config", "=", "my", cwd=tmp_path) == {"my robot.toml"}
    assert asked(bash_script, "failstop", "run", "--config", "=", cwd=tmp_path) == here
    assert asked(bash_script, "failstop", "drive", "-0.1", "", cwd=tmp_path) == set()
    assert asked(bash_script, "failstop", "drive", "0", "--for", "2", "--na") == {"--name"}
    assert asked(bash_script, "failstop", "incident", "pl") == {"plot"}


def said(*command: str, cwd: Path | None = None) -> str:
    result = subprocess.run(command, capture_output=True, text=True, timeout=30, cwd=cwd)
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


def offered(file: Path, line: str) -> set[str]:
    """Words that fish offers."""
    rows = said("fish", "--no-config", "-c", f'source {file}; complete -C "{line}"', cwd=file.parent)
    return {found.partition("\t")[0] for found in rows.splitlines()}


def test_bash_completes_what_is_typed(bash_script: Path) -> None:
    """An interactive shell on a terminal: the function is bound to the command."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="dumb", PS1="$ ", INPUTRC="/dev/null", HISTFILE="/dev/null")
        os.execvp("bash", ["bash", "--norc", "--noprofile", "-i"])
    try:
        os.write(terminal, f"source {bash_script}; echo sour''ced\n".encode())
        read_until(terminal, b"\nsourced")
        os.write(terminal, b"failstop ena\t--js")
        read_until(terminal, b"failstop enable --js")
    finally:
        os.close(terminal)
        os.waitpid(pid, 0)


def read_until(terminal: int, wanted: bytes, timeout_s: float = 20.0) -> None:
    seen, until_s = b"", time.monotonic() + timeout_s
    while wanted not in seen:
        left_s = until_s - time.monotonic()
        assert left_s > 0, seen
        if select.select((terminal,), (), (), left_s)[0]:
            seen += os.read(terminal, 4096)


def shell(name: str) -> str:
    found = shutil.which(name)
    if not found:
        pytest.skip(f"{name} is not installed")
    return found


@pytest.mark.parametrize("name", completion.SHELLS)
def test_the_shell_takes_the_script(name: str, tmp_path: Path) -> None:
    file = tmp_path / "script"
    file.write_text(completion.script(name))
    result = subprocess.run([shell(name), "-n", str(file)], capture_output=True, text=True, timeout=20)
    assert (result.returncode, result.stderr) == (0, "")


def test_fish_completes(tmp_path: Path) -> None:
    shell("fish")
    file = tmp_path / "failstop.fish"
    file.write_text(completion.script("fish"))
    assert offered(file, "failstop ") == {*cli.COMMANDS, "help"}
    assert "--config" in offered(file, "failstop run --")
    assert "failstop.fish" in offered(file, "failstop run --config ")


@pytest.mark.parametrize("name", completion.SHELLS)
def test_every_command_and_option_is_in_the_script(name: str) -> None:
    text = completion.script(name)
    for parser in every_command():
        assert parser.prog.split()[-1] in text
        for flag in flags(parser):
            kind = "l" if flag.startswith("--") else "s"
            assert (f"-{kind} {flag.lstrip('-')} " if name == "fish" else flag) in text, flag

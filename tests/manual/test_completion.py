"""Completion: bash is asked for real, zsh and fish where they are installed."""

from __future__ import annotations

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
from failstop.cli.commands import completion
from failstop.cli.manual import grammar
from failstop.incidents.file import SUFFIX

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


def asked(script: Path, *words: str, cwd: Path | None = None, environ: dict[str, str] | None = None) -> set[str]:
    """What bash offers for the last of the words."""
    result = subprocess.run(
        ["bash", "--norc", "-c", ASK, "ask", str(script), *words],
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
        cwd=cwd,
        env={**os.environ, **(environ or {})},
    )
    assert result.stderr == ""
    return set(result.stdout.split("\n")) - {""}


def every_command() -> list[grammar.Command]:
    return [below for _, commands in grammar.read() for command in commands for below in command.walk()]


def test_bash_offers_every_command(bash_script: Path) -> None:
    assert asked(bash_script, "failstop", "") == {*cli.COMMANDS, "help"}
    assert asked(bash_script, "failstop", "dr") == {"drive"}
    assert asked(bash_script, "failstop", "help", "ena") == {"enable"}
    assert asked(bash_script, "failstop", "--v") == {"--version"}


def test_bash_offers_every_option_and_choice(bash_script: Path) -> None:
    lines, expected = [], []
    for command in every_command():
        lines.append(("failstop", *command.path, "--"))
        expected.append({flag for option in command.options for flag in option.flags if flag.startswith("--")})
        for option in command.options:
            if option.choices:
                lines.append(("failstop", *command.path, option.flags[-1], ""))
                expected.append(set(option.choices))
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
    assert asked(bash_script, "failstop", "completion", "") == set(completion.SHELLS)
    assert asked(bash_script, "failstop", "completion", "bash", "") == set()


def test_bash_offers_the_instances_for_a_name(bash_script: Path, tmp_path: Path) -> None:
    for name in ("left", "lower", "right"):
        (tmp_path / "failstop" / name).mkdir(parents=True)
        os.mkfifo(tmp_path / "failstop" / name / "stop")
    (tmp_path / "failstop" / "leftover").mkdir()
    (tmp_path / "failstop" / "left" / "lock").write_text(f"{os.getpid()}\n")
    (tmp_path / "failstop" / "lower" / "lock").write_text("999999999\n")
    environ = {"XDG_RUNTIME_DIR": str(tmp_path)}
    assert asked(bash_script, "failstop", "status", "--name", "l", environ=environ) == {"left"}
    assert asked(bash_script, "failstop", "status", "--name", "ri", environ=environ) == {"right"}


def test_bash_offers_the_incidents(bash_script: Path, tmp_path: Path) -> None:
    folder = tmp_path / "failstop" / "left" / "incidents"
    folder.mkdir(parents=True)
    (folder / f"19700101-000000-gate-died{SUFFIX}").touch()
    (folder / "19700102-else.txt").touch()
    environ = {"XDG_STATE_HOME": str(tmp_path)}
    assert asked(bash_script, "failstop", "incident", "show", "1970", environ=environ) == {"19700101-000000-gate-died"}
    assert "last" in asked(bash_script, "failstop", "incident", "show", "", environ=environ)
    assert asked(bash_script, "failstop", "incident", "pl") == {"plot"}


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


def test_zsh_and_fish_find_instances_and_incidents(tmp_path: Path) -> None:
    place = tmp_path / "failstop" / "left"
    (place / "incidents").mkdir(parents=True)
    (place / "incidents" / f"19700101-000000-gate-died{SUFFIX}").touch()
    os.mkfifo(place / "stop")
    (tmp_path / "failstop" / "gone").mkdir()
    os.mkfifo(tmp_path / "failstop" / "gone" / "stop")
    (tmp_path / "failstop" / "gone" / "lock").write_text("999999999\n")
    environ = {**os.environ, "XDG_STATE_HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
    asking = {
        "zsh": "compdef() { }; compadd() { print -l ${(P)2} }; source FILE; _failstop_incidents; _failstop_instances",
        "fish": "source FILE; __failstop_incidents; __failstop_instances",
    }
    found = [name for name in asking if shutil.which(name)]
    if not found:
        pytest.skip("neither zsh nor fish is installed")
    for name in found:
        file = tmp_path / name
        file.write_text(completion.script(name))
        command = [name, "-f" if name == "zsh" else "--no-config", "-c", asking[name].replace("FILE", str(file))]
        result = subprocess.run(command, capture_output=True, text=True, timeout=20, env=environ)
        assert (result.returncode, result.stderr) == (0, "")
        assert {"last", "19700101-000000-gate-died", "left"} <= set(result.stdout.split())
        assert "gone" not in result.stdout.split()


def test_fish_completes(tmp_path: Path) -> None:
    file = tmp_path / "failstop.fish"
    file.write_text(completion.script("fish"))

    def offered(line: str) -> set[str]:
        command = [shell("fish"), "--no-config", "-c", f'source {file}; complete -C "{line}"']
        result = subprocess.run(command, capture_output=True, text=True, timeout=20, cwd=tmp_path)
        assert (result.returncode, result.stderr) == (0, "")
        return {found.partition("\t")[0] for found in result.stdout.splitlines()}

    assert offered("failstop ") == set(cli.COMMANDS)
    assert offered("failstop completion ") == set(completion.SHELLS)
    assert "--config" in offered("failstop run --")
    assert "failstop.fish" in offered("failstop run --config ")


@pytest.mark.parametrize("name", completion.SHELLS)
def test_every_command_and_option_is_in_the_script(name: str) -> None:
    text = completion.script(name)
    for command in every_command():
        assert command.path[-1] in text
        for option in command.options:
            for flag in option.flags:
                if name == "fish" or flag.startswith("--"):
                    shown = f"-{'l' if flag.startswith('--') else 's'} {flag.lstrip('-')} " if name == "fish" else flag
                    assert shown in text, flag

"""`failstop install` and `uninstall` as commands, into the files of a system that does not run."""

from __future__ import annotations

import builtins
import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.cli import main as cli
from failstop.install import InstallError, plan, tree
from failstop.install.system import System
from failstop.version import VERSION
from tests.install.scene import INSTALLED, environment, snapshot

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="makes users in a directory, which needs root")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small environment: the real one is tested by itself."""
    monkeypatch.setattr(tree, "running", lambda prefix, interpreter, extras: environment())
    monkeypatch.setattr(tree, "interpreter", lambda: "/usr/bin/python3")


def run(root: Path, *words: str) -> int:
    return cli.main([words[0], "--root", str(root), *words[1:]])


@needs_root
def test_into_an_empty_directory_and_out_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "install", "--yes", "--device", "/dev/board") == 0
    found = snapshot(tmp_path)
    accounts = {f"etc/{name}" for name in ("passwd", "group", "shadow", "gshadow", ".pwd.lock")}
    files = {path for path, (kind, _, _) in found.items() if kind != "d"}
    assert {path for path in files if not path.endswith((".pyc", "-"))} == accounts | INSTALLED | {
        "etc/systemd/system/dev-failstop.device.wants/failstop.service",
        "etc/systemd/system/multi-user.target.wants/failstop.service",
        "etc/systemd/system/sleep.target.wants/failstop-sleep.service",
        "opt/failstop/bin/python3",
        "usr/local/bin/failstop",
        "var/lib/systemd/catalog/database",
    }
    assert b"failstop:" in found["etc/passwd"][2]
    assert b'path = "/dev/board"' in found["etc/failstop/failstop.toml"][2]
    wanted = found["etc/systemd/system/multi-user.target.wants/failstop.service"]
    assert wanted[2] == b"/etc/systemd/system/failstop.service"
    assert cli.main(["config", "--check", str(tmp_path / "etc/failstop/failstop.toml")]) == 0
    capsys.readouterr()
    assert run(tmp_path, "install", "--yes") == 0
    assert capsys.readouterr().out == f"nothing to do: failstop {VERSION} is installed\n"
    assert snapshot(tmp_path) == found
    assert run(tmp_path, "uninstall", "--yes", "--purge") == 0
    left = {path for path in snapshot(tmp_path) if "failstop" in path}
    assert left == set()
    assert "failstop" not in (tmp_path / "etc/passwd").read_text() + (tmp_path / "etc/group").read_text()


@needs_root
def test_what_the_page_needs_is_copied_when_it_is_asked_for_and_as_long_as_it_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, ...]] = []

    def running(prefix: str, interpreter: str, extras: tuple[str, ...]) -> tree.Environment:
        asked.append(extras)
        return environment()

    monkeypatch.setattr(tree, "running", running)
    words = ("install", "--yes", "--device", "/dev/board")
    assert run(tmp_path, *words) == run(tmp_path, *words, "--web") == run(tmp_path, *words[:2]) == 0
    assert asked == [(), ("web",), ("web",)]


@needs_root
@pytest.mark.parametrize("failing", ["systemd-sysusers", "journalctl"])
def test_a_program_that_fails_leaves_the_directory_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], failing: str
) -> None:
    real = System.run

    def run_and_fail(self: System, words: tuple[str, ...], accepted: tuple[int, ...] = (0,)) -> None:
        real(self, words, accepted)
        if words[0] == failing:
            raise InstallError(f"{failing} failed at its end")

    monkeypatch.setattr(System, "run", run_and_fail)
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/sh\n")
    before = snapshot(tmp_path)
    assert run(tmp_path, "install", "--yes") == 1
    assert "failed at its end; everything is as it was before" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


def test_a_dry_run_changes_nothing_and_needs_no_root(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert run(tmp_path, "install", "--dry-run") == 0
    assert "create  /opt/failstop" in capsys.readouterr().out
    assert run(tmp_path, "install", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert {"verb": "create", "subject": "/usr/local/bin/failstop", "remark": "the command"} in found["steps"]
    assert found["restarts"] == []
    assert snapshot(tmp_path) == {}
    assert run(tmp_path, "uninstall", "--dry-run") == 1
    assert "no installation" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["install", "uninstall"])
def test_without_root_the_command_to_type_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(sys, "argv", ["/venv/bin/failstop", command, "--root", "/a b"])
    assert run(tmp_path, command) == 1
    assert f"needs root: sudo /venv/bin/failstop {command} --root '/a b'" in capsys.readouterr().err


def test_without_systemd_that_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(os.path, "isdir", lambda path: False)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert cli.main(["install"]) == 1
    assert "systemd does not run this machine: `failstop run` is the service" in capsys.readouterr().err


PURGE_A_MOUNT = """
mount -t tmpfs tmpfs "$1/var/lib/failstop" && mkdir -p "$1/var/lib/failstop/front/incidents"
"$0" -m failstop uninstall --yes --purge --root "$1" && ls -A "$1/var/lib/failstop" && stat -fc %T "$1/var/lib/failstop"
"""


@needs_root
def test_a_purge_empties_a_state_directory_that_is_a_mount_of_its_own(tmp_path: Path) -> None:
    assert run(tmp_path, "install", "--yes", "--device", "/dev/board") == 0
    state = tmp_path / "var/lib/failstop"
    state.mkdir()
    command = ["unshare", "--mount", "sh", "-c", PURGE_A_MOUNT, sys.executable, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == f"failstop: {state} is empty, but a mount of its own: remove it by hand\n"
    assert done.stdout.endswith("\ndone\ntmpfs\n")
    assert {path for path in snapshot(tmp_path) if "failstop" in path} == {"var/lib/failstop"}


@needs_root
@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("YES", 0), ("", 2), ("n", 2), (None, 2)])
def test_it_asks_first(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answer: str | None,
    code: int,
) -> None:
    def reply(question: str) -> str:
        assert question == "Go ahead? [y/N] "
        if answer is None:
            raise EOFError
        return answer

    monkeypatch.setattr(builtins, "input", reply)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    assert run(tmp_path, "install") == code
    assert bool(snapshot(tmp_path)) == (code == 0)
    if code:
        assert "refused: not wanted; nothing was changed" in capsys.readouterr().err


@needs_root
def test_with_nobody_to_ask_it_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    assert run(tmp_path, "install") == 2
    assert "nobody to ask: say --yes" in capsys.readouterr().err
    assert snapshot(tmp_path) == {}


@needs_root
def test_a_configuration_that_this_version_refuses_is_said_before_anything_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "etc/failstop").mkdir(parents=True)
    (tmp_path / "etc/failstop/failstop.toml").write_text("[gate]\nperiod = 1\n")
    before = snapshot(tmp_path)
    assert run(tmp_path, "install", "--yes") == 1
    assert "gate.period" in capsys.readouterr().err
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--name", "A B"), "name 'A B'"),
        (("--device", ""), "--device"),
        (("--name", "front"), "robot 'front' needs a board of its own"),
    ],
)
def test_impossible_wishes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    assert run(tmp_path, "install", "--dry-run", *words) == 1
    assert said in capsys.readouterr().err
    assert run(tmp_path / "absent", "install", "--dry-run") == 1
    assert "no such directory" in capsys.readouterr().err


@needs_root
@pytest.mark.parametrize("words", [("--dry-run", "--yes"), ("--dry-run",), ("--json", "--yes")])
def test_a_dry_run_of_uninstall_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    assert run(tmp_path, "install", "--yes", "--device", "/dev/board") == 0
    before = snapshot(tmp_path)
    capsys.readouterr()
    assert run(tmp_path, "uninstall", "--purge", *words) == 0
    assert "/opt/failstop" in capsys.readouterr().out
    assert snapshot(tmp_path) == before


@needs_root
@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("", 2), ("n", 2)])
@pytest.mark.parametrize(
    ("restarts", "asked"), [((), "Go ahead? [y/N] "), (("x",), "The wheels stop. Go ahead? [y/N] ")]
)
def test_uninstall_asks_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str, code: int, restarts: tuple[str, ...], asked: str
) -> None:
    assert run(tmp_path, "install", "--yes", "--device", "/dev/board") == 0
    before = snapshot(tmp_path)
    questions: list[str] = []
    real = plan.uninstall
    monkeypatch.setattr(plan, "uninstall", lambda *given: dataclasses.replace(real(*given), restarts=restarts))
    monkeypatch.setattr(builtins, "input", lambda question: (questions.append(question), answer)[1])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    assert run(tmp_path, "uninstall") == code
    assert questions == [asked]
    assert (snapshot(tmp_path) == before) is (code != 0)

"""`make versions` finds the interpreters that there are; `make wheels` asks for what pyproject.toml needs, for
each Python that it allows: only there the index is asked."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.support.commands import script

PROGRAM = Path(__file__).parents[2] / "packaging/versions.py"
PYTHON = """#!/bin/sh
PATH=/usr/bin:/bin
case "$1 $2" in
"-c "*) echo 3.10 ;;
"-m venv") mkdir -p "$4/bin" && cp "$0" "$4/bin/python" ;;
"-m pip") ;;
"-m pytest")
    echo "what pytest said"
    last=$(ls {at}/code* | tail -n 1)
    code=$(cat "$last") && rm "$last" && exit "$code" ;;
esac
"""
"""An interpreter of 3.10 whose tests end with the codes that are written there, the last file's first."""


@pytest.fixture
def versions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """packaging/versions.py, which finds nothing that `make interpreter` has unpacked here."""
    monkeypatch.syspath_prepend(str(PROGRAM.parent))
    program: Any = script(PROGRAM)
    monkeypatch.setattr(program.interpreter, "ROOT", tmp_path)
    return program


def interpreter(path: Path, version: str, code: int = 0) -> str:
    """One that says that it is of this version, or that ends with this code."""
    path.parent.mkdir(parents=True)
    path.write_text(f"#!/bin/sh\necho {version}\nexit {code}\n")
    path.chmod(0o755)
    return str(path)


def test_the_first_that_works(versions: ModuleType, tmp_path: Path) -> None:
    environment = {"PATH": f"{tmp_path}/bin", "HOME": str(tmp_path)}
    assert versions.find("3.10", environment) is None
    uv = interpreter(tmp_path / ".local/share/uv/python/cpython-3.10.1-linux/bin/python3", "3.10")
    assert versions.find("3.10", environment) == uv
    interpreter(tmp_path / ".pyenv/versions/3.10.9/bin/python3", "3.11")
    interpreter(tmp_path / "bin/python3.10", "3.10", 127)  # a shim of pyenv's, of a version that is not chosen
    assert versions.find("3.10", environment) == uv
    other = interpreter(tmp_path / "elsewhere/versions/3.10.13/bin/python3", "3.10")
    assert versions.find("3.10", {**environment, "PYENV_ROOT": str(tmp_path / "elsewhere")}) == other


def test_an_unpacked_interpreter_is_found(versions: Any, tmp_path: Path) -> None:
    environment = {"PATH": f"{tmp_path}/bin", "HOME": str(tmp_path)}
    unpacked = interpreter(tmp_path / "build/pythons/3.14/usr/bin/python3.14", "3.14")
    assert versions.find("3.14", environment) == unpacked
    assert versions.find("3.13", environment) is None


@pytest.mark.parametrize(
    ("here", "whole", "chosen"),
    [
        (["3.10", "3.12", "3.14"], False, ["3.10", "3.14"]),
        (["3.10", "3.12", "3.14"], True, ["3.10", "3.12", "3.14"]),
        (["3.11"], False, ["3.11"]),
        ([], True, []),
    ],
)
def test_the_oldest_and_the_newest_here_are_tried(
    versions: Any, here: list[str], whole: bool, chosen: list[str], tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    monkeypatch.setattr(versions, "find", lambda version, _: version if version in here else None)
    monkeypatch.setattr(versions, "tried", lambda version, *_: (True, f"python {version}: good"))
    assert versions.main(tmp_path, whole) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0].split()[1] for line in lines] == list(versions.VERSIONS)
    assert [line.split()[1].rstrip(":") for line in lines if line.endswith(": good")] == chosen
    [of_3_14] = [line for line in lines if line.startswith("python 3.14: ")]
    assert of_3_14.endswith("next: make interpreter PYTHON_VERSION=3.14") == ("3.14" not in here)


@pytest.mark.parametrize(("codes", "said"), [("0", "good"), ("1 0", "good"), ("1 1", "FAILED"), ("2", "FAILED")])
def test_what_fails_beside_others_is_tried_again_alone_and_told(
    versions: Any, codes: str, said: str, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, folder in (("PATH", "bin"), ("HOME", "home"), ("PYENV_ROOT", "pyenv"), ("UV_PYTHON_INSTALL_DIR", "uv")):
        monkeypatch.setenv(name, str(tmp_path / folder))
    for left, one in enumerate(reversed(codes.split())):
        (tmp_path / f"code{left}").write_text(one)
    python = tmp_path / "bin/python3.10"
    python.parent.mkdir()
    python.write_text(PYTHON.format(at=tmp_path))
    python.chmod(0o755)
    code = versions.main(tmp_path / "at")
    out = capsys.readouterr().out
    assert (code, f"python 3.10: {said}, " in out) == (said == "FAILED", True)
    assert code == 0 or out.startswith("what pytest said\n")
    absent = "python 3.13: not tried, because none was found (on the path, of pyenv, of uv)"
    assert f"\n{absent}; next: make interpreter PYTHON_VERSION=3.13\n" in out
    assert not list(tmp_path.glob("code*"))


@pytest.mark.starts
def test_what_was_installed_before_is_tried_in_a_second_step(
    versions: Any, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, folder in (("PATH", "bin"), ("HOME", "home"), ("PYENV_ROOT", "pyenv"), ("UV_PYTHON_INSTALL_DIR", "uv")):
        monkeypatch.setenv(name, str(tmp_path / folder))
    python = tmp_path / "bin/python3.10"
    python.parent.mkdir()
    python.write_text(PYTHON.format(at=tmp_path))
    python.chmod(0o755)
    (tmp_path / "code0").write_text("0")
    at = tmp_path / "at"
    assert versions.main(at, step="install") == 0
    assert "python 3.10: installed, " in capsys.readouterr().out
    assert (tmp_path / "code0").exists(), "no test has run"
    installed = (at / "3.10/bin/python").stat().st_mtime_ns
    assert versions.main(at, step="test") == 0
    assert "python 3.10: good, " in capsys.readouterr().out
    assert not (tmp_path / "code0").exists()
    assert (at / "3.10/bin/python").stat().st_mtime_ns == installed
    assert versions.main(at, step="toast") == 2
    assert "there is no step toast: use STEP=install, STEP=test or neither" in capsys.readouterr().err


ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    return script(ROOT / "packaging" / "wheels.py")


def test_every_python_that_is_allowed_is_asked_for(wheels: Any) -> None:
    project = (ROOT / "pyproject.toml").read_text()
    named = re.findall(r"Programming Language :: Python :: (3\.\d+)", project)
    assert list(wheels.PYTHONS) == named
    assert f'requires-python = ">={named[0]},<3.{int(named[-1][2:]) + 1}"' in project


def test_a_condition_is_of_the_python_that_is_asked_for(wheels: Any) -> None:
    dependencies = ["numpy>=1.24", "tomli>=2.0; python_version < '3.11'"]
    assert wheels.needed(dependencies, "3.10") == ["numpy>=1.24", "tomli>=2.0"]
    assert wheels.needed(dependencies, "3.11") == ["numpy>=1.24"]


def test_what_has_no_wheel_is_named(wheels: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    class Done:
        def __init__(self, command: list[str]) -> None:
            assert "--only-binary=:all:" in command
            assert "manylinux_2_28_aarch64" in command
            self.returncode = int(command[-1].startswith("numpy"))

    monkeypatch.setattr(wheels.subprocess, "run", lambda command, **_: Done(command))
    assert wheels.missing(["numpy>=1.24", "msgpack>=1.1"], "3.12", "aarch64", "/tmp") == ["numpy>=1.24"]


def test_every_python_is_tried_and_asked_for(versions: Any, wheels: Any) -> None:
    assert versions.VERSIONS == wheels.PYTHONS

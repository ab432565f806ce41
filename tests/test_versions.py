"""`make versions` finds the interpreters that there are, and says which it lacks."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.commands import script

PROGRAM = Path(__file__).parents[1] / "packaging/versions.py"


@pytest.fixture(scope="module")
def versions() -> ModuleType:
    return script(PROGRAM)


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


@pytest.mark.parametrize(
    ("good", "code", "said"),
    [(True, 0, "python 3.10: good, "), (False, 1, "python 3.10: FAILED, ")],
)
def test_what_is_said(
    versions: ModuleType,
    good: bool,
    code: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["versions", str(tmp_path)])
    monkeypatch.setattr(versions, "find", lambda version, _: "python" if version == "3.10" else None)
    monkeypatch.setattr(versions, "run", lambda *_: (good, "" if good else "what pytest said\n"))
    assert versions.main() == code
    out = capsys.readouterr().out
    assert said in out
    assert good or out.startswith("what pytest said\n")
    assert out.endswith("python 3.13: none here (on the path, of pyenv, of uv): not tried\n")

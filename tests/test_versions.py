"""`make versions` finds the interpreters that there are, and says which it lacks."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.support.commands import script

PROGRAM = Path(__file__).parents[1] / "packaging/versions.py"
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
    ("codes", "code", "said"),
    [
        ("0", 0, "python 3.10: good, "),
        ("1 0", 0, "python 3.10: good, "),
        ("1 1", 1, "python 3.10: FAILED, "),
        ("2", 1, "python 3.10: FAILED, "),
    ],
)
def test_what_is_said(
    versions: ModuleType,
    codes: str,
    code: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Tests that fail beside others are tried again alone."""
    for name, folder in (("PATH", "bin"), ("HOME", "home"), ("PYENV_ROOT", "pyenv"), ("UV_PYTHON_INSTALL_DIR", "uv")):
        monkeypatch.setenv(name, str(tmp_path / folder))
    for left, one in enumerate(reversed(codes.split())):
        (tmp_path / f"code{left}").write_text(one)
    python = tmp_path / "bin/python3.10"
    python.parent.mkdir()
    python.write_text(PYTHON.format(at=tmp_path))
    python.chmod(0o755)
    assert versions.main(tmp_path / "at") == code
    out = capsys.readouterr().out
    assert said in out
    assert code == 0 or out.startswith("what pytest said\n")
    assert out.endswith("python 3.13: none here (on the path, of pyenv, of uv): not tried\n")
    assert not list(tmp_path.glob("code*"))

"""What goes into the Debian package, and who is said to maintain it."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from tests.install.scene import MANUAL, PARTS, SHELLS

SCRIPT = Path(__file__).resolve().parents[2] / "packaging/deb/build.py"


@pytest.fixture(scope="module")
def build() -> ModuleType:
    spec = importlib.util.spec_from_file_location("failstop_deb_build", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_completion_is_where_the_shells_look(build: ModuleType) -> None:
    files = build.files(PARTS)
    assert {shell: files[path] for shell, path in build.COMPLETIONS.items()} == SHELLS
    assert MANUAL not in files.values(), "the manual goes in compressed"


def test_every_unit_is_in_it(build: ModuleType) -> None:
    """Those that are started on request too."""
    units = {path.rpartition("/")[2] for path in build.files(PARTS) if path.startswith("usr/lib/systemd/system/")}
    assert units == {path.name for path in (SCRIPT.parents[2] / "systemd").glob("*.service")}


@pytest.mark.starts
def test_the_maintainer(build: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("GIT_CONFIG_NOSYSTEM", "1")
    both = {"DEBFULLNAME": "Anna Builder", "DEBEMAIL": "anna@example.org"}
    assert build.maintainer(both, tmp_path) == "Anna Builder <anna@example.org>"
    assert build.maintainer({}, tmp_path) == build.NOBODY
    assert build.maintainer({"DEBFULLNAME": "Anna"}, tmp_path) == build.NOBODY, "half of it is nobody"
    (tmp_path / ".gitconfig").write_text("[user]\nname = Bob\nemail = bob@example.org\n")
    assert build.maintainer({}, tmp_path) == "Bob <bob@example.org>"
    assert build.maintainer(both, tmp_path).startswith("Anna")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build.maintainer({}, tmp_path) == build.NOBODY

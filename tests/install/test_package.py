"""What goes into the Debian package, and who is said to maintain it."""

from __future__ import annotations

import importlib.util
import re
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from failstop.install.rows import EXTRAS, OWN, ROWS
from tests.install.scene import MANUAL, SHELLS, TEXTS

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
    files = build.files(TEXTS)
    assert {row.source: files[row.package.lstrip("/")] for row in ROWS if row.source in SHELLS} == SHELLS
    assert [path for path, text in files.items() if text == MANUAL] == ["usr/share/man/man1/failstop.1.gz"]


@pytest.mark.starts
def test_the_scripts_know_every_unit(build: ModuleType) -> None:
    """That of the rows, as the build writes them."""
    scripts = {name: build.script(name) for name in build.SCRIPTS}
    for extra in EXTRAS:
        assert extra.source in scripts["postinst"]
        assert extra.source in scripts["prerm"]
    for row in OWN:
        assert (row.source in scripts["postrm"]) == row.boot, row
    for name, text in scripts.items():
        assert not re.search(r"@[A-Z]+@", text), name
        subprocess.run(["sh", "-n"], input=text, text=True, check=True)


def test_every_unit_is_in_it(build: ModuleType) -> None:
    """Those that are started on request too."""
    units = {path.rpartition("/")[2] for path in build.files(TEXTS) if path.startswith("usr/lib/systemd/system/")}
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

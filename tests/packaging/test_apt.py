"""The signed apt folder: gpgv believes it, apt's own tool reads it, and what is changed is refused."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.deb import apt

pytestmark = pytest.mark.starts
KEY = "tester@example.org"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A keyring with a key without a passphrase."""
    folder = tmp_path_factory.mktemp("gnupg")
    folder.chmod(0o700)
    words = ("gpg", "--homedir", str(folder), "--batch", "--passphrase", "", "--quick-generate-key", KEY, "ed25519")
    if subprocess.run(["which", "gpg", "gpgv", "apt-get"], capture_output=True).returncode:
        pytest.skip("not installed: gpg, gpgv or apt")
    subprocess.run(words, check=True, capture_output=True)
    return folder


def package(folder: Path, name: str, architecture: str) -> None:
    root = folder / f"{name}-{architecture}"
    (root / "DEBIAN").mkdir(parents=True)
    fields = {"Package": name, "Version": "1", "Architecture": architecture, "Maintainer": "a", "Description": "b"}
    (root / "DEBIAN/control").write_text("".join(f"{field}: {text}\n" for field, text in fields.items()))
    subprocess.run(["dpkg-deb", "--root-owner-group", "--build", root, folder], check=True, capture_output=True)


@pytest.fixture
def release(tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GNUPGHOME", str(home))
    for name, architecture in (("failstop", "amd64"), ("failstop", "arm64"), ("failstop-lab", "all")):
        package(tmp_path, name, architecture)
    return tmp_path


def update(folder: Path, place: Path) -> subprocess.CompletedProcess[str]:
    """apt-get update with this folder as the only source."""
    place.mkdir()
    (place / "list").write_text(f"deb [signed-by={folder}/{apt.PUBLIC}] file:{folder} {apt.SUITE} {apt.COMPONENT}\n")
    for part in ("lists/partial", "cache/archives/partial", "empty"):
        (place / part).mkdir(parents=True)
    options = {
        "Dir::Etc::SourceList": place / "list",
        "Dir::Etc::SourceParts": place / "empty",
        "Dir::State::Lists": place / "lists",
        "Dir::Cache": place / "cache",
        "APT::Sandbox::User": "root" if os.geteuid() == 0 else "",
        "Acquire::GzipIndexes": "false",
        "APT::Architecture": "arm64",
        "APT::Architectures": "arm64",
    }
    words = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    return subprocess.run(["apt-get", "update", *words], capture_output=True, text=True, check=False)


def test_apt_believes_the_folder_and_refuses_what_was_changed(release: Path) -> None:
    out = release / "apt"
    lines = apt.make(release, out, "https://example.org/apt", KEY)
    assert len(lines.splitlines()) == 3
    assert f"signed-by={apt.KEYRING}] https://example.org/apt stable main" in lines
    done = update(out, release / "good")
    assert done.returncode == 0, done.stderr
    assert "W:" not in done.stderr
    (listed,) = (release / "good/lists").glob("*binary-arm64_Packages")
    assert listed.read_text().count("Package: ") == 2
    index = out / "dists/stable/main/binary-arm64/Packages"
    index.write_text(index.read_text().replace("Version: 1", "Version: 2"))
    (index.parent / "Packages.gz").unlink()
    changed = update(out, release / "changed")
    assert changed.returncode, "a package that nobody signed"
    (out / "dists/stable/InRelease").write_text(
        (out / "dists/stable/InRelease").read_text().replace("failstop", "other")
    )
    assert update(out, release / "forged").returncode


def test_without_packages_or_a_key_it_says_what_to_do(release: Path, tmp_path: Path) -> None:
    with pytest.raises(apt.AptError, match="make release VERSION=x"):
        apt.make(tmp_path / "apt", tmp_path / "out", "https://example.org", KEY)
    with pytest.raises(apt.AptError, match="gpg --list-secret-keys has your keys"):
        apt.make(release, tmp_path / "out", "https://example.org", "nobody@example.org")
    assert not (tmp_path / "out").exists()

"""An upgrade from the files of an older commit: as if nothing older had been there, with the settings kept."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.install.scene import snapshot

CHECKOUT = Path(__file__).resolve().parents[2]
OLDER = {"34a3881": "the first that could be installed", "a74265f": "the last whose plan was not made of rows"}
"""Commits of this repository."""
GONE = Path("etc/systemd/system/failstop-gone.service")
"""A unit that the older version had and this one has not: none of them has lost one yet."""
SETTINGS = Path("etc/failstop/failstop.toml")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(180),
    pytest.mark.skipif(os.geteuid() != 0, reason="makes users in a directory, which needs root"),
]


def install(checkout: Path, root: Path) -> str:
    """Install a checkout into a root directory with the packages of the tests' environment; returns what it said."""
    command = [sys.executable, "-m", "failstop", "install", "--root", str(root), "--yes", "--device", "/dev/board"]
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    done = subprocess.run(
        command, cwd=checkout, env=environment, capture_output=True, text=True, timeout=90, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def older(commit: str, place: Path) -> Path:
    """The files of a commit."""
    words = ["git", "-C", str(CHECKOUT), "archive", commit]
    try:
        packed = subprocess.run(words, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"the commit {commit} is not in this checkout")
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(place)
    return place


def had_a_unit_more(checkout: Path) -> None:
    """One that takes the place of another is left over by an upgrade that does not look."""
    for path in (checkout / "failstop/install").glob("*.py"):
        path.write_text(path.read_text().replace('"failstop@.service"', f'"{GONE.name}"'))
    (checkout / "systemd/failstop@.service").rename(checkout / "systemd" / GONE.name)


def files(root: Path) -> dict[str, tuple[str, int, bytes]]:
    """What an installation has put there; accounts and catalog are the machine's, and the list has its own order."""
    found = snapshot(root)
    return {
        path: kept
        for path, kept in found.items()
        if not path.endswith((".pyc", "install.json", "-", "etc/shadow", "etc/.pwd.lock", str(SETTINGS)))
        and not path.startswith("var/lib/systemd")
    }


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, int, bytes]]:
    """What this version installs where nothing was."""
    root = tmp_path_factory.mktemp("fresh")
    install(CHECKOUT, root)
    return files(root)


@pytest.mark.parametrize("commit", OLDER, ids=OLDER.get)
def test_nothing_is_left_over_and_the_settings_stay(
    commit: str, fresh: dict[str, tuple[str, int, bytes]], tmp_path: Path
) -> None:
    root = tmp_path / "root"
    root.mkdir()
    before = older(commit, tmp_path / "older")
    had_a_unit_more(before)
    install(before, root)
    assert (root / GONE).is_file()
    settings = root / SETTINGS
    settings.write_text("# mine\n" + '[device]\npath = "/dev/board"\n')
    said = install(CHECKOUT, root)
    assert "replace  /opt/failstop" in said
    assert "by hand" not in said, "the list of the older version is believed"
    assert settings.read_text().startswith("# mine\n")
    assert files(root) == fresh
    assert "nothing to do" in install(CHECKOUT, root)
    command = [sys.executable, "-m", "failstop", "uninstall", "--root", str(root), "--yes", "--purge"]
    subprocess.run(command, capture_output=True, check=True, timeout=60)
    assert not [path for path in snapshot(root) if "failstop" in path]

"""A real systemd in a container: the unit there, and a machine to install the Debian package on."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from bench.container import Bind, Container, ContainerMissing
from bench.service_scene import HARDY, UNIT, Scene
from failstop.lab.sim.client import SimBoard
from tests.support.deb import tree
from tests.support.pages import ROOT

from .installing import ASKING, OLDER, SETTINGS, Place, Rebuild


@pytest.fixture(scope="package")
def shared_scene() -> Iterator[Scene]:
    """One container and board for all tests: each starts and ends the service itself."""
    try:
        made = Scene(HARDY)
    except ContainerMissing as reason:
        pytest.skip(str(reason))
    with made:
        yield made


@pytest.fixture
def scene(shared_scene: Scene) -> Iterator[Scene]:
    """The service, ready. It must end well, and leave nothing."""
    shared_scene.start()
    yield shared_scene
    shared_scene.end()
    assert shared_scene.box.pids(UNIT) == []


@pytest.fixture(scope="package")
def shared_place() -> Iterator[Place]:
    tools = ("dpkg", "dpkg-deb", "deb-systemd-helper", f"/usr/bin/{tree.PYTHON}")
    if absent := [tool for tool in tools if not shutil.which(tool)]:
        pytest.skip(f"not installed: {', '.join(absent)}")
    with tempfile.TemporaryDirectory(prefix="failstop-install-") as name:
        directory = Path(name)
        directory.chmod(0o755)
        for part in ("board", "packages"):
            (directory / part).mkdir()
        binds = [Bind(str(directory / "board"), "/board"), Bind(str(directory / "packages"), "/packages")]
        with SimBoard(directory / "board" / "port", mode=0o666) as board:
            try:
                # Images for containers forbid the start of services by packages.
                box = Container({}, binds, "rm -f /usr/sbin/policy-rc.d")
            except ContainerMissing as reason:
                pytest.skip(str(reason))
            with box:
                # No index of every manual page of the machine after each installation.
                box.path("/var/lib/man-db/auto-update").unlink(missing_ok=True)
                yield Place(box, board, directory / "packages")


@pytest.fixture
def place(shared_place: Place) -> Iterator[Place]:
    """A container without failstop, before and after."""
    before = shared_place.files()
    assert shared_place.accounts() == []
    yield shared_place
    # A test that failed does not spoil the next.
    shared_place.box.run("dpkg", "--purge", "failstop", check=False)
    shared_place.unplug()
    left = shared_place.files() ^ before, shared_place.accounts(), shared_place.box.pids(UNIT)
    assert left == (set(), [], [])


@pytest.fixture(scope="package")
def built(shared_place: Place) -> list[str]:
    """The output of the build."""
    build = [sys.executable, str(ROOT / "packaging/deb/build.py"), "--out", str(shared_place.packages)]
    done = subprocess.run(build, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="package")
def package(built: list[str]) -> str:
    """The package's path inside."""
    return f"/packages/{Path(built[0]).name}"


@pytest.fixture(scope="package")
def rebuild(built: list[str], shared_place: Place, tmp_path_factory: pytest.TempPathFactory) -> Rebuild:
    """A function that builds the same package with another version and some files more; returns its path inside."""

    def build(version: str, more: Mapping[str, str]) -> str:
        place = tmp_path_factory.mktemp("older") / "package"
        subprocess.run(["dpkg-deb", "--raw-extract", built[0], str(place)], check=True)
        control = place / "DEBIAN/control"
        lines = control.read_text().splitlines(keepends=True)
        control.write_text("".join(f"Version: {version}\n" if line.startswith("Version:") else line for line in lines))
        for name, text in more.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_text(text)
        out = shared_place.packages / f"failstop_{version}.deb"
        subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", str(place), str(out)], check=True)
        return f"/packages/{out.name}"

    return build


@pytest.fixture(scope="package")
def older(rebuild: Rebuild) -> str:
    """The path inside of the same package with another version."""
    return rebuild(OLDER, {})


@pytest.fixture(scope="package")
def asking(rebuild: Rebuild) -> str:
    """The path inside of an older package that dpkg asks about: the settings are among its files."""
    return rebuild(ASKING, {"DEBIAN/conffiles": f"{SETTINGS}\n", SETTINGS.lstrip("/"): "# the package's\n"})

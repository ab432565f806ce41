"""A real systemd in a container: the unit there, and a machine to install the Debian package on."""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.container import ContainerMissing
from bench.service_scene import CONFIG, HARDY, UNIT, Scene
from failstop.supervisor import status
from tests.support.deb import tree
from tests.support.package_scene import OLDER, SETTINGS, Place, machine
from tests.support.pages import ROOT

LEASE = f"printf '[gate]\\nlease_s = {status.LEASE_WITHOUT_S}\\n' >> {CONFIG}\n"
"""A machine that is busy for a moment is no hang in these tests."""


@pytest.fixture(scope="package")
def shared_scene() -> Iterator[Scene]:
    """One container and board for all tests. The service in it must end well, and leave nothing."""
    try:
        made = Scene(HARDY, setup=LEASE)
    except ContainerMissing as reason:
        pytest.skip(str(reason))
    with made:
        yield made
        made.end()
        assert made.box.pids(UNIT) == []


@pytest.fixture
def scene(shared_scene: Scene) -> Iterator[Scene]:
    """The service, ready: one that others have used and left whole, or a new one."""
    if not shared_scene.whole():
        shared_scene.end()
        shared_scene.start()
    shared_scene.begin()
    yield shared_scene
    shared_scene.leave()


@pytest.fixture(scope="package")
def shared_place() -> Iterator[Place]:
    tools = ("dpkg", "dpkg-deb", "deb-systemd-helper", f"/usr/bin/python{tree.VERSION_HERE}")
    if absent := [tool for tool in tools if not shutil.which(tool)]:
        pytest.skip(f"not installed: {', '.join(absent)}")
    with contextlib.ExitStack() as stack:
        try:
            found = stack.enter_context(machine())
        except ContainerMissing as reason:
            pytest.skip(str(reason))
        yield found


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
    build = [sys.executable, str(ROOT / "packaging/deb/build.py"), "--out", str(shared_place.packages)]
    done = subprocess.run(build, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="package")
def package(built: list[str]) -> str:
    return f"/packages/{Path(built[0]).name}"


@pytest.fixture(scope="package")
def asking(built: list[str], shared_place: Place, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The path inside of the same package as an older one that dpkg asks about: the settings are among its files."""
    place = tmp_path_factory.mktemp("older") / "package"
    subprocess.run(["dpkg-deb", "--raw-extract", built[0], str(place)], check=True)
    control = place / "DEBIAN/control"
    control.write_text(re.sub("^Version: .*", f"Version: {OLDER}", control.read_text(), flags=re.MULTILINE))
    (place / "DEBIAN/conffiles").write_text(f"{SETTINGS}\n")
    settings = place / SETTINGS.lstrip("/")
    settings.parent.mkdir(parents=True)
    settings.write_text("# the package's\n")
    out = shared_place.packages / f"failstop_{OLDER}.deb"
    subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", str(place), str(out)], check=True)
    shutil.rmtree(place)
    return f"/packages/{out.name}"

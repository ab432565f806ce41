"""The sdist, and the wheel made from it, install and work outside the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path

import pytest

from failstop.messages import layout
from failstop_lab.commands import demo as demo_command
from tests.support.deb import tree
from tests.support.pages import ROOT

QUIETLY = ("--quiet", "--no-compile", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with what builds packages, and no failstop."""
    return new_environment(tmp_path_factory.mktemp("tools"), "build", "setuptools>=77")


def new_environment(place: Path, *packages: str) -> Path:
    """An environment with these packages; they come without pip."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True, timeout=120)
    install(place, *packages)
    return place


def install(environment: Path, *packages: str) -> None:
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "install"]
    subprocess.run([*pip, *QUIETLY, *packages], check=True, capture_output=True, timeout=280)


@pytest.fixture(scope="module")
def built(environment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist and the wheel that was built from it."""
    out = tmp_path_factory.mktemp("dist")
    build = [str(environment / "bin" / "python"), "-m", "build", "--no-isolation"]
    for words in (["--outdir", out, ROOT], ["--wheel", "--outdir", out / "lab", ROOT / "lab"]):
        subprocess.run([*build, *map(str, words)], check=True, capture_output=True, timeout=280)
    return out


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_wheel_and_sdist_hold_one_package(built: Path) -> None:
    wheel = zipfile.ZipFile(next(built.glob("*.whl")))
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"failstop"}
    for room in ("board", "shm", "supervisor", "procs/gate", "procs/port_owner", "procs/stopper", "procs/telemetry"):
        assert f"failstop/{room}/__init__.py" in wheel.namelist()
    for path in ("ros2/bridge.py", "ros2/udp_only.xml"):
        assert f"failstop/{path}" in wheel.namelist()
    assert "failstop/ros2/packages/failstop_msgs/msg/Status.msg" in wheel.namelist()
    assert "failstop/py.typed" in wheel.namelist()
    laboratory = zipfile.ZipFile(next((built / "lab").glob("*.whl"))).namelist()
    assert {name.split("/")[0] for name in laboratory if ".dist-info" not in name} == {"failstop_lab"}
    assert not [name for name in wheel.namelist() if name.startswith("failstop_lab")]
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        assert not [member.name for member in sdist if member.issym()]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_installed_command_works_outside_the_checkout(built: Path, tmp_path: Path) -> None:
    """The wheel, which was built from the sdist, beside what it says that it needs, as that is installed here."""
    environment = new_environment(tmp_path / "venv", "--no-deps", str(next(built.glob("*.whl"))))
    (site,) = environment.glob("lib/python*/site-packages")
    for distribution in tree.needed(without=()):
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            (site / top).symlink_to(distribution.locate_file(top))
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def demo() -> subprocess.CompletedProcess[str]:
        command = [str(environment / "bin" / "failstop"), "demo"]
        return subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True, timeout=60, check=False)

    refused = demo()
    assert refused.returncode == 1
    where = "next: install failstop-lab (docs/install.md)"
    assert refused.stderr == f"failstop: `failstop demo` is not installed here; {where}\n"
    install(environment, "--no-deps", str(next((built / "lab").glob("*.whl"))))
    start_s = time.monotonic()
    shown = demo()
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert time.monotonic() - start_s < 40, "a promise of the README: it is quick, and says what it saw"
    for process in (demo_command.PROGRAM, *layout.PROCESS_NAMES):
        assert f"kill -9 {process} " in shown.stdout
    assert "nothing moved again" in shown.stdout

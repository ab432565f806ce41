"""The Python environment of the package as a list of files."""

from __future__ import annotations

import importlib.util
import json
import marshal
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.deb import tree

BASE = os.path.realpath(getattr(sys, "_base_executable", sys.executable))


@pytest.fixture(scope="module")
def running() -> list[Any]:
    return tree.running()


def tops(entries: list[Any]) -> set[str]:
    """Entries of site-packages."""
    return {entry.path.split("/")[3] for entry in entries if entry.path.startswith(tree.SITE)}


def test_the_running_environment_is_whole_and_has_of_the_checkout_the_package_alone(running: list[Any]) -> None:
    paths = [entry.path for entry in running]
    assert len(paths) == len(set(paths))
    found = {name.split("-")[0].split(".")[0] for name in tops(running)}
    assert found >= {"failstop", "msgpack", "numpy", "posix_ipc", "psutil", "serial"}
    assert not found & {"pytest", "hypothesis", "shtab", "__editable__", "tests", "bench", "packaging"}
    inside = f"{tree.SITE}/failstop"
    for room in ("board/rrc/codec.py", "shm/cell.py", "supervisor/main.py", "supervisor/child.py", "web/page/page.js"):
        assert f"{inside}/{room}" in paths
    assert not any("__pycache__" in path or "/tests/" in path for path in paths)
    links = {entry.path: entry.target for entry in running if entry.target}
    assert links == {"bin/python3": f"/usr/bin/{tree.PYTHON}", "bin/python": "python3"}


def test_written_it_runs_by_itself(running: list[Any], tmp_path: Path) -> None:
    place = tmp_path / "environment"
    tree.write(running, place)
    (place / "bin/python3").unlink()
    (place / "bin/python3").symlink_to(BASE)
    (place / "pyvenv.cfg").write_text(f"home = {os.path.dirname(BASE)}\n")
    needed = "import failstop, msgpack, numpy, posix_ipc, psutil, serial; print(numpy.__file__, failstop.__file__)"
    said = subprocess.run(
        [place / "bin/python3", "-I", "-W", "error", "-c", needed], check=True, capture_output=True, text=True, cwd="/"
    )
    assert all(path.startswith(str(place)) for path in said.stdout.split())
    script = (place / "bin/failstop").read_text()
    assert script.startswith("#!/opt/failstop/bin/python3 -I\n")
    config = [str(place / "bin/python3"), "-I", str(place / "bin/failstop"), "config", "--json"]
    assert "device.path" in json.loads(subprocess.run(config, check=True, capture_output=True, cwd="/").stdout)
    modules = sorted(place.rglob("*.py"))
    assert len(modules) > 100
    assert all(list((module.parent / "__pycache__").glob(f"{module.stem}.cpython-*.pyc")) for module in modules)


def test_the_modules_are_compiled_for_their_place(tmp_path: Path) -> None:
    tree.write([tree.Entry("module.py", "where = lambda: 0\n")], tmp_path / "new")
    code = "import module; print(module.__cached__, module.where.__code__.co_filename)"
    said = subprocess.run([BASE, "-v", "-c", code], cwd=tmp_path / "new", capture_output=True, text=True, check=True)
    cached = importlib.util.cache_from_source(str(tmp_path / "new/module.py"))
    assert said.stdout.split()[0] == cached
    # What follows the 16 bytes that say of which source it is.
    assert marshal.loads(Path(cached).read_bytes()[16:]).co_filename == "/opt/failstop/module.py"
    assert f"matches {tmp_path / 'new/module.py'}" in said.stderr


def lacking(package: str) -> Callable[[str], metadata.Distribution]:
    """Finds what is installed but for this package."""

    def find(name: str) -> metadata.Distribution:
        if name == package:
            raise metadata.PackageNotFoundError(name)
        return metadata.distribution(name)

    return find


def test_a_package_that_is_not_there_is_named() -> None:
    with pytest.raises(tree.BuildError, match=r"Python package msgpack is not in the environment .*`make deb` does"):
        tree.running(find=lacking("msgpack"))


def test_what_an_extra_needs_comes_along_where_it_is_asked_for() -> None:
    def found(*extras: str) -> set[str]:
        return tops(tree.running(extras))

    assert not found() & {"tornado", "segno", "paho", "prometheus_client", "matplotlib", "pytest"}
    assert found("web") - found() >= {"tornado", "segno"}
    assert found("web", "fleet") - found("web") >= {"paho", "prometheus_client"}
    with pytest.raises(tree.BuildError, match="Python package tornado is not in the environment"):
        tree.running(("web",), lacking("tornado"))


def test_every_package_comes_with_the_text_of_its_licence() -> None:
    texts: dict[str, list[str]] = {}
    for entry in tree.running(("web", "fleet")):
        top, _, inside = entry.path.removeprefix(f"{tree.SITE}/").partition("/")
        if top.endswith(".dist-info"):
            found = texts.setdefault(top.partition("-")[0], [])
            if "LICEN" in inside.upper() or "COPYING" in inside.upper():
                found.append(entry.text or Path(entry.source).read_text())
    assert {"failstop", "numpy", "pyserial", "tornado"} <= set(texts)
    assert [name for name, found in texts.items() if not any(len(text) > 500 for text in found)] == []
    assert "Chris Liechti" in texts["pyserial"][0]
    # numpy has a folder of headers, which is left out, and below its licences one of the same name.
    assert any("divide" in text for text in texts["numpy"])


def test_a_package_without_the_text_of_its_licence_is_refused() -> None:
    files = [metadata.PackagePath("x-1.dist-info/METADATA")]
    files[0].dist = SimpleNamespace(locate_file=lambda path: "/nowhere")  # type: ignore[assignment]
    alone = SimpleNamespace(name="x", version="1", requires=["x"], files=files)
    with pytest.raises(tree.BuildError, match=r"^x 1 has no text of its licence: .* licences\.py$"):
        tree.running(find=lambda _: alone)


def test_a_package_that_is_not_pip_s_is_refused() -> None:
    with pytest.raises(tree.BuildError, match="which files belong to the Python package x is not recorded"):
        tree.running(find=lambda _: SimpleNamespace(name="x", requires=["x"], files=None))

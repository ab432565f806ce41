"""The Python environment of the package as a list of files."""

from __future__ import annotations

import importlib.util
import io
import json
import marshal
import os
import subprocess
import sys
import tarfile
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


NEEDED = ("msgpack", "psutil", "serial", *(("posix_ipc",) if sys.version_info < (3, 14) else ()))
"""What failstop imports of others; from Python 3.14 on it makes its segments without posix-ipc."""


def tops(entries: list[Any]) -> set[str]:
    """Entries of site-packages."""
    return {entry.path.split("/")[1] for entry in entries if entry.path.startswith(tree.SITE)}


def test_the_running_environment_is_whole_and_has_of_the_checkout_the_package_alone(running: list[Any]) -> None:
    paths = [entry.path for entry in running]
    assert len(paths) == len(set(paths))
    found = {name.split("-")[0].split(".")[0] for name in tops(running)}
    assert found >= {"failstop", *NEEDED}
    assert not found & {"numpy", "pytest", "hypothesis", "shtab", "__editable__", "tests", "bench", "packaging"}
    inside = f"{tree.SITE}/failstop"
    for room in (
        "board/rrc/codec.py",
        "shm/cell.py",
        "supervisor/main.py",
        "supervisor/bootstrap.py",
        "web/page/page.js",
    ):
        assert f"{inside}/{room}" in paths
    assert not any("__pycache__" in path or "/tests/" in path for path in paths)
    links = {entry.path: entry.target for entry in running if entry.target}
    assert links == {"bin/python3": "/usr/bin/python3", "bin/python": "python3"}


def test_written_it_runs_by_itself(running: list[Any], tmp_path: Path) -> None:
    place = tmp_path / "environment"
    tree.write(running, place)
    (place / f"lib/python{tree.VERSION_HERE}/site-packages/failstop.pth").write_text(f"{place / tree.SITE}\n")
    (place / "bin/python3").unlink()
    (place / "bin/python3").symlink_to(BASE)
    (place / "pyvenv.cfg").write_text(f"home = {os.path.dirname(BASE)}\n")
    needed = f"import failstop, {', '.join(NEEDED)}; print(msgpack.__file__, failstop.__file__)"
    said = subprocess.run(
        [place / "bin/python3", "-I", "-W", "error", "-c", needed], check=True, capture_output=True, text=True, cwd="/"
    )
    assert all(path.startswith(str(place)) for path in said.stdout.split())
    script = (place / "bin/failstop").read_text()
    assert script.startswith("#!/opt/failstop/bin/python3 -IB\n"), "what root runs leaves no modules when it is removed"
    config = [str(place / "bin/python3"), "-I", str(place / "bin/failstop"), "config", "--json"]
    assert "device.path" in json.loads(subprocess.run(config, check=True, capture_output=True, cwd="/").stdout)
    modules = sorted(place.rglob("*.py"))
    assert len(modules) > 100
    unpack(tree.compiled(place, BASE), place)
    assert all(list((module.parent / "__pycache__").glob(f"{module.stem}.cpython-*.pyc")) for module in modules)


def unpack(packed: bytes, place: Path) -> None:
    """As the installation does."""
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(place)


def test_the_modules_are_compiled_for_their_place(tmp_path: Path) -> None:
    tree.write([tree.Entry("site-packages/module.py", "where = lambda: 0\n")], tmp_path / "new")
    packed = tree.compiled(tmp_path / "new", BASE)
    assert tree.compiled(tmp_path / "new", BASE) == packed
    unpack(packed, tmp_path / "new")
    site = tmp_path / "new/site-packages"
    code = "import module; print(module.__cached__, module.where.__code__.co_filename)"
    said = subprocess.run([BASE, "-v", "-c", code], cwd=site, capture_output=True, text=True, check=True)
    cached = importlib.util.cache_from_source(str(site / "module.py"))
    assert said.stdout.split()[0] == cached
    # What follows the 16 bytes that say of which source it is.
    assert marshal.loads(Path(cached).read_bytes()[16:]).co_filename == "/opt/failstop/site-packages/module.py"
    assert f"matches {site / 'module.py'}" in said.stderr


def test_modules_are_compiled_with_the_same_hashes_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to Python 3.10 the order of a compiled set depends on them."""
    tree.write([tree.Entry("site-packages/module.py", "x = 1\n")], tmp_path / "new")
    python, log = tmp_path / "python3", tmp_path / "log"
    python.write_text(
        '#!/bin/sh\nflags=\nfor word; do [ "$word" != -c ] || break; flags="$flags $word"; done\n'
        f"""{BASE} $flags -c 'print(hash("a"))' >>{log}\nexec {BASE} "$@"\n"""
    )
    python.chmod(0o755)
    for seed in ("1", "2", "random"):
        monkeypatch.setenv("PYTHONHASHSEED", seed)
        tree.compiled(tmp_path / "new", str(python))
    hashes = log.read_text().split()
    assert hashes == hashes[:1] * 3


def here(find: Any) -> dict[str, Any]:
    """It finds what is for this Python."""
    return {tree.VERSION_HERE: find}


def lacking(package: str) -> Callable[[str], metadata.Distribution]:
    """Finds what is installed but for this package."""

    def find(name: str) -> metadata.Distribution:
        if name == package:
            raise metadata.PackageNotFoundError(name)
        return metadata.distribution(name)

    return find


def test_a_package_that_is_not_there_is_named() -> None:
    with pytest.raises(tree.BuildError, match=r"Python package msgpack is not in the environment .*`make deb` does"):
        tree.running((), here(lacking("msgpack")))


def test_what_an_extra_needs_comes_along_where_it_is_asked_for() -> None:
    def found(*extras: str) -> set[str]:
        return tops(tree.running(extras))

    assert not found() & {"tornado", "segno", "paho", "prometheus_client", "matplotlib", "pytest"}
    assert found("web") - found() >= {"tornado", "segno"}
    assert found("web", "fleet") - found("web") >= {"paho", "prometheus_client"}
    with pytest.raises(tree.BuildError, match="Python package tornado is not in the environment"):
        tree.running(("web",), here(lacking("tornado")))


def test_every_package_comes_with_the_text_of_its_licence() -> None:
    texts: dict[str, list[str]] = {}
    for entry in tree.running(("web", "fleet")):
        top, _, inside = entry.path.removeprefix(f"{tree.SITE}/").partition("/")
        if top.endswith(".dist-info"):
            found = texts.setdefault(top.partition("-")[0], [])
            if "LICEN" in inside.upper() or "COPYING" in inside.upper():
                found.append(entry.text or Path(entry.source).read_text())
    assert {"failstop", "pyserial", "tornado"} <= set(texts)
    assert [name for name, found in texts.items() if not any(len(text) > 500 for text in found)] == []
    assert "Chris Liechti" in texts["pyserial"][0]


def test_a_package_without_the_text_of_its_licence_is_refused() -> None:
    files = [metadata.PackagePath("x-1.dist-info/METADATA")]
    files[0].dist = SimpleNamespace(locate_file=lambda path: "/nowhere")  # type: ignore[assignment]
    alone = SimpleNamespace(name="x", version="1", requires=["x"], files=files)
    with pytest.raises(tree.BuildError, match=r"^x 1 has no text of its licence: .* licences\.py$"):
        tree.running((), here(lambda _: alone))


def test_a_package_that_is_not_pip_s_is_refused() -> None:
    with pytest.raises(tree.BuildError, match="which files belong to the Python package x is not recorded"):
        tree.running((), here(lambda _: SimpleNamespace(name="x", requires=["x"], files=None)))


def installed(folder: Path, name: str, files: dict[str, str]) -> None:
    """A small distribution with these files, and a licence."""
    about = {f"{name}-1.dist-info/METADATA": f"Name: {name}\nVersion: 1\n", f"{name}-1.dist-info/LICENSE": "free\n"}
    rows = {**files, **about, f"{name}-1.dist-info/WHEEL": f"Tag: {folder.name}\n"}
    for path, text in rows.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    (folder / f"{name}-1.dist-info/RECORD").write_text("".join(f"{path},,\n" for path in rows))


def fake(folder: Path) -> Any:
    """Finds x in a folder, and a failstop that needs it."""
    whole = SimpleNamespace(name="failstop", requires=["x"])
    find = tree.finder(folder)
    return lambda name: whole if name == "failstop" else find(name)


def test_one_folder_has_the_packages_of_every_python(tmp_path: Path) -> None:
    for python in ("3.11", "3.13"):
        installed(tmp_path / python, "x", {"x/__init__.py": "", f"x/fast.cpython-{python}.so": python})
    finds = {python: fake(tmp_path / python) for python in ("3.11", "3.13")}
    paths = {entry.path for entry in tree.running((), finds)}
    assert {f"site-packages/x/fast.cpython-{python}.so" for python in finds} < paths
    assert {f"lib/python{python}/site-packages/failstop.pth" for python in finds} < paths
    assert not any("x-1.dist-info/WHEEL" in path or "x-1.dist-info/RECORD" in path for path in paths)
    (tmp_path / "3.13/x/__init__.py").write_text("other = 1\n")
    with pytest.raises(tree.BuildError, match=r"x/__init__\.py is not the same for Python 3\.13 as for 3\.11"):
        tree.running((), finds)

"""The Python environment as a list of files, and the parts that a version brings."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from failstop.cli.commands import completion
from failstop.install import InstallError, rows, tree
from failstop.install.rows import EXTRAS
from tests.install.scene import UNIT, environment

BASE = os.path.realpath(getattr(sys, "_base_executable", sys.executable))


@pytest.fixture(scope="module")
def running() -> tree.Environment:
    return tree.running("/opt/failstop", BASE)


def test_the_running_environment_is_whole_and_nothing_of_the_checkout_but_the_package(
    running: tree.Environment,
) -> None:
    paths = [entry.path for entry in running.entries]
    assert len(paths) == len(set(paths))
    tops = {path.split("/")[3].split("-")[0].split(".")[0] for path in paths if path.startswith(tree.SITE)}
    assert tops >= {"failstop", "msgpack", "numpy", "psutil", "serial"}
    assert not tops & {"pytest", "hypothesis", "__editable__", "tests", "bench"}
    inside = f"{tree.SITE}/failstop"
    for room in (
        "board/codec.py",
        "shm/cell.py",
        "supervisor/main.py",
        "supervisor/child.py",
        "systemd/failstop.service",
    ):
        assert f"{inside}/{room}" in paths
    assert not any("__pycache__" in path or "/tests/" in path for path in paths)


def test_written_it_runs_by_itself_and_is_known_again(running: tree.Environment, tmp_path: Path) -> None:
    place = tmp_path / "environment"
    running.write(str(place))
    assert running.is_at(str(place), "install.json")
    needed = "import failstop, msgpack, numpy, psutil, serial; print(numpy.__file__, failstop.__file__)"
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
    environment = tree.Environment("/opt/failstop", BASE, (tree.Entry("module.py", b"where = lambda: 0\n"),))
    environment.write(str(tmp_path / "new"))
    code = "import module; print(module.__cached__, module.where.__code__.co_filename)"
    said = subprocess.run([BASE, "-v", "-c", code], cwd=tmp_path / "new", capture_output=True, text=True, check=True)
    assert said.stdout.split()[0] == importlib.util.cache_from_source(str(tmp_path / "new/module.py"))
    assert f"matches {tmp_path / 'new/module.py'}" in said.stderr


def test_content_names_and_links_count(tmp_path: Path) -> None:
    first = environment()
    first.write(str(tmp_path / "a"))

    def found() -> bool:
        return first.is_at(str(tmp_path / "a"), "install.json")

    assert found()
    assert not environment("2.0").is_at(str(tmp_path / "a"), "install.json")
    (tmp_path / "a/install.json").write_text("is not counted")
    assert found()
    module = tmp_path / "a/lib/module.py"
    module.rename(module.with_name("other.py"))
    assert not found()
    module.with_name("other.py").rename(module)
    assert found()
    (tmp_path / "a/bin/python3").unlink()
    (tmp_path / "a/bin/python3").symlink_to("/elsewhere")
    assert not found()
    (tmp_path / "a/bin/python3").unlink()
    (tmp_path / "a/bin/python3").write_bytes(b"")
    assert not found()


def lack(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    """This package is not installed."""
    real = metadata.distribution

    def found(name: str) -> metadata.Distribution:
        if name == package:
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(metadata, "distribution", found)


def test_a_package_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    lack(monkeypatch, "msgpack")
    with pytest.raises(InstallError, match=r"Python package msgpack is not installed .*with pip into a virtual env"):
        tree.running("/opt/failstop", BASE)


def test_what_an_extra_needs_comes_along_where_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def tops(*extras: str) -> set[str]:
        entries = tree.running("/opt/failstop", BASE, extras).entries
        return {entry.path.split("/")[3] for entry in entries if entry.path.startswith(tree.SITE)}

    assert not tops() & {"tornado", "segno", "paho", "prometheus_client", "matplotlib", "pytest"}
    assert tops("web") - tops() >= {"tornado", "segno"}
    assert tops("web", "fleet") - tops("web") >= {"paho", "prometheus_client"}
    lack(monkeypatch, "tornado")
    with pytest.raises(InstallError, match=r"Python package tornado is not .*pip install 'failstop\[web\]' there"):
        tree.running("/opt/failstop", BASE, ("web",))


def test_a_copy_of_a_copy_is_the_same(tmp_path: Path) -> None:
    """What /opt/failstop runs `failstop install` with: it knows its extras, and what they need."""
    first = tree.running("/opt/failstop", BASE, ("web",))
    first.write(str(tmp_path / "a"))
    code = (
        "from failstop.install import tree; import sys;"
        "print(tree.running('/opt/failstop', sys.argv[1], ('web',)).is_at(sys.argv[2], ''))"
    )
    words = [str(tmp_path / "a/bin/python3"), "-I", "-c", code, BASE, str(tmp_path / "a")]
    assert subprocess.run(words, check=True, capture_output=True, text=True, cwd="/").stdout == "True\n"


def test_a_package_that_is_not_pip_s_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata.Distribution, "files", None)
    with pytest.raises(InstallError, match=r"which files belong to the Python package .* is not recorded"):
        tree.running("/opt/failstop", BASE)


def test_what_the_service_could_not_run() -> None:
    for path in ("/root/.venv/bin/python", "/home/me/venv/bin/python", "/tmp/venv/bin/python"):
        assert "is hidden from it" in tree.unreachable(path)
    assert tree.unreachable("/bin/sh") == ""
    for path in ("/bin/absent", "/etc/passwd"):
        assert "is not there, or can't be run" in tree.unreachable(path)


def test_the_interpreter_is_one_that_the_service_can_run(monkeypatch: pytest.MonkeyPatch) -> None:
    systems = f"/usr/bin/{tree.PYTHON}"
    monkeypatch.setattr(sys, "_base_executable", "/opt/python/bin/python3", raising=False)
    monkeypatch.setattr(tree, "unreachable", lambda path: "")
    assert tree.interpreter() == "/opt/python/bin/python3"
    monkeypatch.setattr(tree, "unreachable", lambda path: "" if path == systems else "hidden")
    assert tree.interpreter() == systems
    monkeypatch.setattr(tree, "unreachable", lambda path: "hidden")
    with pytest.raises(InstallError, match=rf"could not run /opt/python/bin/python3: hidden. Install {tree.PYTHON} as"):
        tree.interpreter()


def test_the_parts_of_this_version_fit_what_the_plan_does_with_them() -> None:
    found = rows.texts()
    units = {name: text for name, text in found.items() if name.endswith(".service")}
    assert all(rows.UNIT_COMMAND in text for text in units.values())
    wanted = {name: rows.wanted_by(text)[:1] for name, text in units.items()}
    assert wanted == {
        "failstop.service": ["multi-user.target"],
        "failstop@.service": ["multi-user.target"],
        "failstop-sleep.service": ["sleep.target"],
        rows.LATE: [],
        **{extra.source: ["multi-user.target"] for extra in EXTRAS},
    }
    lines = found["failstop.sysusers"].splitlines()
    assert f'u {rows.USER} - "failstop, which makes the robot stop" /var/lib/failstop' in lines
    assert f"m {rows.USER} {rows.PORT_GROUP}" in lines
    assert "path = " in found[rows.SETTINGS]
    assert found["failstop.catalog"].count("Defined-By: failstop") > 3
    assert ".TH FAILSTOP 1" in found["failstop.1"]
    assert all("failstop" in found[shell] for shell in completion.SHELLS)
    assert found.keys() == {row.source for row in rows.ROWS} | {rows.SETTINGS, rows.FLEET_SETTINGS}


def test_units_are_read_as_systemd_reads_them() -> None:
    assert rows.wanted_by(UNIT) == ["multi-user.target", "some.device"]
    assert rows.wanted_by("[Install]\n#WantedBy=a\nWantedBy=b\nWantedBy=c d\n") == ["b", "c", "d"]

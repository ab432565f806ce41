"""The Debian packages of the C library: what is in them, and that a build leaves no trace of the builder."""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import pytest

from failstop.version import VERSION
from tests.packaging import life
from tests.support.c_client import compiler
from tests.support.deb import build, c_library
from tests.support.pages import ROOT

NEWEST_LIBC = (2, 35)
"""Of Ubuntu 22.04; what is newer, or is renamed in newer ones, would keep a program from running there."""


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    compiler()
    folder = tmp_path_factory.mktemp("packed")
    found: list[Path] = build.library(folder / "in", folder)
    return found


def content(package: Path) -> dict[str, str]:
    done = subprocess.run(["dpkg-deb", "--contents", package], check=True, capture_output=True, text=True)
    rows = (line.split(maxsplit=5) for line in done.stdout.splitlines())
    return {row[5].partition(" -> ")[0]: row[5].partition(" -> ")[2] for row in rows if not row[5].endswith("/")}


def test_a_program_runs_with_one_package_and_is_compiled_with_the_other(packed: list[Path]) -> None:
    runtime, development = map(content, packed)
    folder = f"./usr/lib/{c_library.TRIPLETS[life.architecture()]}"
    assert [path for path in runtime if "/doc/" not in path] == [f"{folder}/libfailstop.so.0"]
    assert development[f"{folder}/libfailstop.so"] == "libfailstop.so.0"
    for file in ("failstop.pc", "failstop-config.cmake", "failstop.h", "failstop.hpp", "libfailstop.a", "patrol.c"):
        assert [path for path in development if path.endswith(f"/{file}")], file
    field = subprocess.run(["dpkg-deb", "--field", packed[1], "Depends"], check=True, capture_output=True, text=True)
    assert f"libfailstop0 (= {build.DEBIAN})" in field.stdout


def test_the_same_source_gives_the_same_bytes(
    packed: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    outs = []
    for number in (1, 2):
        outs.append(tmp_path / ("out" * number))
        outs[-1].mkdir()
        monkeypatch.setattr(tempfile, "tempdir", str(outs[-1]))
        build.library(outs[-1] / "in", outs[-1])
    for package in packed:
        assert (outs[0] / package.name).read_bytes() == (outs[1] / package.name).read_bytes(), package.name


def test_the_library_runs_with_the_oldest_libc_that_is_promised(packed: list[Path], tmp_path: Path) -> None:
    subprocess.run(["dpkg-deb", "--extract", packed[0], tmp_path], check=True)
    (library,) = tmp_path.rglob("libfailstop.so.0")
    versions = {(2, int(minor)) for minor in re.findall(rb"GLIBC_2\.(\d+)", library.read_bytes())}
    assert max(versions) <= NEWEST_LIBC
    assert VERSION.encode() in library.read_bytes()
    assert str(ROOT).encode() not in library.read_bytes(), "no path of the builder"


def test_without_a_compiler_the_build_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(build.BuildError, match="apt install make gcc libc6-dev"):
        c_library.compiler("amd64", "amd64")
    with pytest.raises(build.BuildError, match="apt install make gcc-aarch64-linux-gnu"):
        c_library.compiler("arm64", "amd64")
